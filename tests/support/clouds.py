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
