"""Both networks on the same regions of benchmark clouds, where the heavier one would take hours for whole ones.

    python experiments/regions.py CLOUD... [--levels 0.25,0.5,1,1.5,2.5] [--regions 3] [--points 400]

Each region is that of the whole cloud's denoising: its points see what they would see there, pass by pass. Prints
point-to-surface distance x 1e3 and mean normal error in degrees over all regions of a cloud, a line a cloud and level.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pcdnf import Denoiser
from pcdnf.benchmark.clouds import CleanCloud, read_clouds
from pcdnf.inference.unit_frame import UnitFrame
from pcdnf.metrics import normal_error, point_to_surface

MODELS = ("pcdnf", "pcdnf-lite")
MOVED = 1.2
"""Points this many radii away may be neighbours once they have moved."""

Floats = NDArray[np.float64]


def rows_of(tree: cKDTree, picks: NDArray[np.int64], points: int) -> NDArray[np.int64]:
    """The nearest points of each pick."""
    return np.unique(tree.query(tree.data[picks], points)[1])


def around(tree: cKDTree, rows: NDArray[np.int64], reach: float) -> NDArray[np.int64]:
    """Every point within reach of some row."""
    return np.unique(np.concatenate(tree.query_ball_point(tree.data[rows], reach)).astype(np.int64))


def denoised(denoiser: Denoiser, noisy: Floats, rows: NDArray[np.int64]) -> tuple[Floats, NDArray[np.float32]]:
    """Points and normals of ``rows`` as a run over the whole cloud would make them."""
    plan, frame, tree = denoiser.plan(noisy), UnitFrame.of(noisy), cKDTree(noisy)
    needed = [rows]
    for radius in plan.radii[:0:-1]:
        needed.insert(0, around(tree, needed[0], MOVED * radius * frame.diagonal))
    current, raw = noisy, None
    for iteration, wanted in enumerate(needed):
        cloud = denoiser.prepare(
            current, raw, plan=plan, iteration=iteration, frame=frame, initial="input" if iteration else "auto",
            seed=iteration, came=noisy, oriented=False,
        )  # fmt: skip
        place = np.empty(len(noisy), np.int64)
        place[cloud.order] = np.arange(len(noisy))
        chosen = cloud.order[np.sort(place[wanted])]
        tile = denoiser.denoise_rows(cloud, chosen)
        current = current.copy()
        normals = cloud.normals.copy()
        current[chosen], normals[chosen] = tile.points, tile.normals
        raw = normals
    assert raw is not None
    return current[rows], raw[rows]


def measure(cloud: CleanCloud, level: float, denoisers: dict[str, Denoiser], regions: int, points: int) -> str:
    """A line of the table."""
    noisy = cloud.noisy(level)
    tree = cKDTree(noisy)
    rows = rows_of(tree, np.random.default_rng(0).integers(len(noisy), size=regions), points)
    found = []
    for denoiser in denoisers.values():
        moved, normals = denoised(denoiser, noisy, rows)
        distance = point_to_surface(moved, cloud.points, cloud.normals)
        angle, _ = normal_error(moved, normals, cloud.points, cloud.normals)
        found.append((distance, angle))
    shown = " | ".join(f"{distance:.2f}, {angle:.1f}" for distance, angle in found)
    return f"| {cloud.name} | {level:g} % | {shown} | {found[1][0] / found[0][0]:.2f} |"


def main() -> None:
    """Denoise the regions and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clouds", nargs="+", type=Path)
    parser.add_argument("--levels", default="0.25,0.5,1,1.5,2.5", help="per cent of the diagonal")
    parser.add_argument("--regions", type=int, default=3, help="of a cloud")
    parser.add_argument("--points", type=int, default=400, help="of a region")
    arguments = parser.parse_args()
    denoisers = {name: Denoiser.load(name, device="cpu") for name in MODELS}
    print(
        f"| cloud | noise | {' | '.join(MODELS)} | P2S of the second to the first |\n|---|---|---|---|---|", flush=True
    )
    for cloud in read_clouds(arguments.clouds):
        for level in map(float, arguments.levels.split(",")):
            print(measure(cloud, level, denoisers, arguments.regions, arguments.points), flush=True)


if __name__ == "__main__":
    main()
