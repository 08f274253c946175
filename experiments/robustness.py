"""What the method makes of clouds that are not like the paper's: pictures before and after, and a table.

    python experiments/robustness.py FOLDER [SCAN.ply ...] [--model M] [--iterations auto] [--points 60000]

On a shape by formula (a block: edges, corners, planes) with known surface: 1 to 4 % of Gaussian noise, outliers in the
box, density that falls by 16 along the shape, holes, scan lines, and all of it together. Real scans have no clean form:
for them the table gives how rough the surface is (RMS distance of a point to the plane of its 24 neighbours) before and
after, in thousandths of the diagonal, how far points moved, and how many came back as they were. A scan of more than
``--most`` points is cut to those nearest to its middle.

Writes FOLDER/robustness.md and a PNG for each case; what is there is written again.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pcdnf import Denoiser
from pcdnf.benchmark.clouds import block
from pcdnf.benchmark.noise import add_noise
from pcdnf.formats import PointCloud, read
from pcdnf.geometry.frames import principal_axes
from pcdnf.geometry.normals import pca_normals
from pcdnf.inference.results import DenoiseResult
from pcdnf.metrics import score
from pcdnf.models.catalog import DEFAULT_MODEL
from pcdnf.render.panels import render_comparison

Floats = NDArray[np.float64]

SEED = 5_000_000
NEIGHBOURS = 24
SIZE = (1600, 900)
"""Pixels of a picture."""
SCAN_LINES = 90
"""Rows into which the sampling is drawn together, across the shape's height."""


@dataclass(frozen=True)
class Case:
    """A noisy cloud with its clean one."""

    noisy: Floats
    clean: Floats
    normals: Floats


def _case(points: int, kept: Callable[[Floats], NDArray[np.bool_]] | None, kind: str, level: float) -> Case:
    """A block whose sampling is thinned by ``kept``, then made noisy."""
    clean, normals = block(np.random.default_rng(SEED), points)
    rows = slice(None) if kept is None else kept(clean)
    return Case(add_noise(clean[rows], level, kind), clean, normals)


def falling_density(clean: Floats) -> NDArray[np.bool_]:
    """Sixteen times denser at one end than at the other."""
    share = (clean[:, 0] - clean[:, 0].min()) / np.ptp(clean[:, 0])
    return np.random.default_rng(SEED + 1).random(len(clean)) < 16.0**-share


def holes(clean: Floats) -> NDArray[np.bool_]:
    """Twelve balls without points."""
    middles = clean[np.random.default_rng(SEED + 2).choice(len(clean), 12, replace=False)]
    distance, _ = cKDTree(middles).query(clean)
    return distance > 0.08


def scan_lines(clean: Floats) -> NDArray[np.bool_]:
    """Points near evenly spaced lines only."""
    phase = (clean @ np.array([0.2, 0.1, 1.0])) * SCAN_LINES
    return np.abs(phase - np.round(phase)) < 0.12


def all_of_it(clean: Floats) -> NDArray[np.bool_]:
    """Falling density and holes."""
    return falling_density(clean) & holes(clean)


def made_cases(points: int) -> dict[str, Case]:
    """The cases with a known surface, by name."""
    cases = {f"noise of {level:g} %": _case(points, None, "gaussian", level) for level in (1, 2, 3, 4)}
    cases["outliers, 0.5 %"] = _case(points, None, "outliers", 0.5)
    cases["falling density, 0.7 %"] = _case(points, falling_density, "gaussian", 0.7)
    cases["holes, 0.7 %"] = _case(points, holes, "gaussian", 0.7)
    cases["scan lines, 0.7 %"] = _case(points, scan_lines, "gaussian", 0.7)
    cases["density, holes, outliers, 1 %"] = _case(points, all_of_it, "outliers", 1.0)
    return cases


def roughness(points: Floats) -> float:
    """RMS distance of a point to the plane of its neighbours, in thousandths of the diagonal."""
    _, index = cKDTree(points).query(points, NEIGHBOURS, workers=-1)
    axes = principal_axes(points, np.asarray(index, np.int64))
    height = ((points - points[index].mean(axis=1)) * axes[:, 2]).sum(axis=1)
    low, high = np.percentile(points, [0.5, 99.5], axis=0)
    return float(np.sqrt(np.mean(height**2)) / np.linalg.norm(high - low) * 1e3)


def middle_part(cloud: PointCloud, most: int) -> PointCloud:
    """The points nearest to the median, in the order of the file."""
    if len(cloud) <= most:
        return cloud
    _, rows = cKDTree(cloud.points).query(np.median(cloud.points, axis=0), most)
    rows = np.sort(rows)
    return PointCloud(
        points=cloud.points[rows],
        normals=None if cloud.normals is None else cloud.normals[rows],
        attributes={name: column[rows] for name, column in cloud.attributes.items()},
    )


def draw(before: PointCloud, result: DenoiseResult, path: Path, title: str) -> None:
    """Before and after, as clay; raw normals shade the first."""
    points = before.points.astype(np.float64)
    shown = PointCloud(points=points, normals=pca_normals(points))
    after = PointCloud(points=result.points, normals=result.normals.astype(np.float64))
    render_comparison(shown, after, path, title=title, size=SIZE, coloured=False)


def main() -> None:
    """Run all cases; write pictures and the table."""

    def passes(text: str) -> int | Literal["auto"]:
        return "auto" if text == "auto" else int(text)

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("scans", type=Path, nargs="*")
    parser.add_argument("--model", default=DEFAULT_MODEL)
    parser.add_argument("--iterations", type=passes, default="auto", help="a number, or auto")
    parser.add_argument("--points", type=int, default=60_000, help="of the made clouds, before thinning")
    parser.add_argument("--most", type=int, default=250_000, help="points of a scan")
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    denoiser = Denoiser.load(arguments.model)
    lines = [
        "| made cloud | points | P2S x 1e3 before | after | normals, PCA, degrees | after | as they were | passes |",
        "|---|---|---|---|---|---|---|---|",
    ]
    print(*lines, sep="\n")

    def finish(name: str, cloud: PointCloud, result: DenoiseResult, line: str) -> None:
        lines.append(line)
        print(line, flush=True)
        stem = "".join(letter if letter.isalnum() else "-" for letter in name)
        draw(cloud, result, arguments.folder / f"{stem}.png", name)

    for name, case in made_cases(arguments.points).items():
        result = denoiser.denoise(case.noisy, iterations=arguments.iterations)
        before = score(case.noisy, pca_normals(case.noisy), case.clean, case.normals)
        after = score(result.points, result.normals, case.clean, case.normals)
        line = (
            f"| {name} | {len(case.noisy):,} | {before.point_to_surface:.2f} | {after.point_to_surface:.2f}"
            f" | {before.normal_mean:.1f} | {after.normal_mean:.1f}"
            f" | {int(result.flagged.sum())} | {result.metadata['iterations']} |"
        )
        finish(name, PointCloud(points=case.noisy), result, line)
    heading = [
        "",
        "| scan | points | roughness x 1e3 before | after | moved x 1e3, median | as they were | passes | seconds |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for scan in arguments.scans:
        if heading:
            lines += heading
            print(*heading, sep="\n")
            heading = []
        cloud = middle_part(read(scan), arguments.most)
        points = cloud.points.astype(np.float64)
        began = time.perf_counter()
        result = denoiser.denoise(points, iterations=arguments.iterations)
        seconds = time.perf_counter() - began
        low, high = np.percentile(points, [0.5, 99.5], axis=0)
        moved = np.median(np.linalg.norm(result.points - points, axis=1)) / np.linalg.norm(high - low) * 1e3
        line = (
            f"| {scan.stem} | {len(points):,} | {roughness(points):.2f} | {roughness(result.points):.2f} | {moved:.2f}"
            f" | {int(result.flagged.sum())} | {result.metadata['iterations']} | {seconds:.0f} |"
        )
        finish(scan.stem, cloud, result, line)
    (arguments.folder / "robustness.md").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
