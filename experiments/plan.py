"""Which patch radius and how many iterations suit a model, on held-out generated shapes: behind ``auto``.

    python experiments/plan.py MODEL [--factors 7,9.8,13] [--later 0.7,1] [--levels 0.25,0.5,1,1.5,2.5]

Point-to-surface distance x 1e3 and normal error in degrees, means over the shapes, a row for each noise level and
choice, a column for each of three iterations. A factor is ``Recipe.adaptive``; each shape is denoised in a crop around
a random point. Needs the ``train`` extra.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pcdnf import Denoiser
from pcdnf.geometry.noise import estimate_noise, normals_reach
from pcdnf.geometry.normals import raw_normals
from pcdnf.geometry.patches import PatchSource
from pcdnf.inference.unit_frame import UnitFrame
from pcdnf.training.shapes import CleanCloud, random_shape

FIRST_SEED = 2_000_000
"""Neither trained on nor validated on."""


def numbers(text: str) -> list[float]:
    """Comma-separated numbers."""
    return [float(value) for value in text.split(",")]


def errors(
    denoiser: Denoiser, shape: CleanCloud, level: float, factor: float, later: float, iterations: int, inner: int
) -> list[tuple[float, float]]:
    """P2S x 1e3 and mean normal error of the ``inner`` points nearest to one, after each iteration."""
    tree = cKDTree(shape.points)
    rng = np.random.default_rng(int(1e6 * level) + len(shape.points))
    noisy = shape.points + rng.normal(size=shape.points.shape) * level / 100
    frame = UnitFrame(np.zeros(3), 1.0)
    scale = estimate_noise(noisy, cKDTree(noisy))
    first = replace(denoiser.recipe, adaptive=factor).adaptive_radius(scale)
    radii = [first, *[first * later] * (iterations - 1)]
    distance = np.linalg.norm(noisy - noisy[rng.integers(len(noisy))], axis=1)
    reach = np.partition(distance, inner)[inner]
    rows = np.flatnonzero(distance < reach + sum(radii))
    points, away, normals = noisy[rows], distance[rows], None
    found = []
    for iteration, radius in enumerate(radii):
        local: NDArray[np.float64] = np.ascontiguousarray(points)
        ball = normals_reach(radius, scale) if denoiser.recipe.normals == "ball" else 0.0
        raw = raw_normals(local, normals, tree=cKDTree(local), reach=ball)
        recipe = replace(denoiser.recipe, radius=radius, adaptive=0.0, fewest=16)
        source = PatchSource(local, raw, recipe, diagonal=frame.diagonal, seed=iteration)
        chosen = np.flatnonzero(away < reach + sum(radii[iteration + 1 :]))
        tile = denoiser.inference.denoise(local, raw, source, chosen)
        points, normals, away = tile.points, tile.normals, away[chosen]
        own = away < reach
        separation, nearest = tree.query(points[own])
        offset = ((points[own] - shape.points[nearest]) * shape.normals[nearest]).sum(1)
        cosine = np.abs((normals[own] * shape.normals[nearest]).sum(1)).clip(0, 1)
        surface = float(np.minimum(separation, np.abs(offset)).mean() * 1e3)
        found.append((surface, float(np.degrees(np.arccos(cosine)).mean())))
    return found


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model")
    parser.add_argument("--factors", type=numbers, default=[7, 9.8, 13])
    parser.add_argument("--later", type=numbers, default=[0.7, 1])
    parser.add_argument("--levels", type=numbers, default=[0.25, 0.5, 1, 1.5, 2.5])
    parser.add_argument("--iterations", type=int, default=3)
    parser.add_argument("--shapes", type=int, default=6)
    parser.add_argument("--points", type=int, default=60_000)
    parser.add_argument("--inner", type=int, default=600)
    arguments = parser.parse_args()
    denoiser = Denoiser.load(arguments.model, device="cpu")
    shapes = [random_shape(np.random.default_rng(FIRST_SEED + i), arguments.points) for i in range(arguments.shapes)]
    names = [f"iteration {i + 1}" for i in range(arguments.iterations)]
    print(f"| noise | factor | later | {' | '.join(names)} |\n|---|---|---|{'---|' * len(names)}")
    for level in arguments.levels:
        for factor in arguments.factors:
            for later in arguments.later:
                rows = [
                    errors(denoiser, shape, level, factor, later, arguments.iterations, arguments.inner)
                    for shape in shapes
                ]
                cells = [f"{surface:.3f}, {angle:.2f}" for surface, angle in np.mean(rows, 0)]
                print(f"| {level:g} % | {factor:g} | {later:g} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
