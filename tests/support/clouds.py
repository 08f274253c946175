"""Clouds that tests of several modules use."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pcdnf.formats import read, write

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def noisy_sphere(count: int, noise: float) -> np.ndarray:
    """A unit sphere (count, 3) float64 with Gaussian noise of this standard deviation a coordinate."""
    rng = np.random.default_rng(0)
    points = rng.normal(size=(count, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True) + noise * rng.normal(size=(count, 3))


def thinned_examples(folder: Path, points: int) -> Path:
    """Make ``examples/`` in a folder: as the repository's, but with so many points a cloud."""
    examples = folder / "examples"
    examples.mkdir()
    for path in EXAMPLES.iterdir():
        target = examples / path.name
        if path.suffix != ".ply":
            target.symlink_to(path)
            continue
        cloud = read(path)
        rows = np.random.default_rng(0).permutation(len(cloud))[points:]
        write(target, cloud.without(np.sort(rows), "Points"))
    return examples


def depth_image() -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """A board before a wall, a wire and a slanted floor, seen from the origin; which rows are flying, wire and rest."""
    rng = np.random.default_rng(0)
    column, row = (each.ravel() for each in np.meshgrid(np.arange(120), np.arange(90)))
    depth = np.where(row < 20, 0.1 / np.maximum((45 - row) / 100, 0.01) * 6, 4.0)  # a floor that runs back to the wall
    depth = np.minimum(depth, 4.0)
    board = (abs(column - 40) <= 15) & (abs(row - 60) <= 20)
    wire = (column == 100) & (row > 25)
    edge = np.isin(column, (24, 56)) & (abs(row - 60) <= 20)
    depth = np.select([board, wire], [2.0, 2.5], depth) + rng.normal(0, 0.002, len(depth))
    depth[edge] = rng.uniform(2.3, 3.7, edge.sum())
    points = np.column_stack([(column - 60) / 100, (row - 45) / 100, np.ones(len(depth))]) * depth[:, None]
    return points, {"flying": edge, "wire": wire, "rest": ~edge & ~wire}
