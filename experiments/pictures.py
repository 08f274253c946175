"""The pictures of the documentation: too little, enough and too much of each parameter, and a scan before and after.

    python experiments/pictures.py docs/images [--only scan,radius,iterations] [--points 8000]

Draws ``scan.png``, ``scan_colours.png``, ``radius.png`` and ``iterations.png`` from the clouds in ``examples/``. The
figures in the pictures are the mean distance of the points to the clean bracket, in thousandths of its diagonal.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from pcdnf import Denoiser
from pcdnf.formats import PointCloud, read
from pcdnf.metrics import point_to_surface
from pcdnf.render.panels import Panel, render_comparison, render_panels

COLOURS = 96
EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
PICTURES = ("scan", "radius", "iterations")
RADII = ("1.2%", "auto", "12%")
PASSES = (1, 2, 4)
SIZE = (920, 1040)
"""Pixels of four clouds in two rows: small to load."""


def denoised(denoiser: Denoiser, cloud: PointCloud, **choices: Any) -> tuple[PointCloud, dict[str, str]]:
    """The cloud after a run, and what the run says of itself."""
    result = denoiser.denoise(cloud.points, **choices)
    return cloud.replaced(result.points, result.normals), result.metadata


def bracket(points: int) -> tuple[PointCloud, PointCloud]:
    """The sample, thinned, and its clean form."""
    noisy, clean = read(EXAMPLES / "bracket_noisy.ply"), read(EXAMPLES / "bracket_clean.ply")
    chosen = np.random.default_rng(0).permutation(len(noisy))[:points]
    return PointCloud(points=noisy.points[np.sort(chosen)]), clean


def distance(cloud: PointCloud, clean: PointCloud) -> str:
    """A caption: how far the points are from the clean surface."""
    value = point_to_surface(cloud.points, clean.points, clean.normals)
    return f"{value:.1f} thousandths off"


def shrink(path: Path) -> None:
    """Few colours: shaded clay looks the same in a third of the bytes."""
    with Image.open(path) as picture:
        picture.quantize(COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)


def scan(denoiser: Denoiser, folder: Path) -> None:
    """Before and after, as clay and in the scan's colours."""
    cloud = read(EXAMPLES / "scan_boxes.ply")
    after, facts = denoised(denoiser, cloud)
    print("scan:", facts)
    captions = (f"{len(cloud):,} points", "all parameters automatic")
    render_comparison(
        cloud, after, folder / "scan.png", size=(860, 560), captions=captions, inset=False, coloured=False
    )
    shrink(folder / "scan.png")
    render_comparison(cloud, after, folder / "scan_colours.png", size=(860, 560), inset=False)
    shrink(folder / "scan_colours.png")


def radius(denoiser: Denoiser, folder: Path, points: int) -> None:
    """Two passes with a radius too small, chosen and too large."""
    noisy, clean = bracket(points)
    panels = [Panel(noisy, "Noisy", distance(noisy, clean))]
    for choice in RADII:
        after, facts = denoised(denoiser, noisy, iterations=2, radius=choice)
        print("radius:", choice, facts, distance(after, clean))
        panels.append(Panel(after, f"radius={choice}", distance(after, clean)))
    render_panels(panels, folder / "radius.png", size=SIZE, inset=False)
    shrink(folder / "radius.png")


def iterations(denoiser: Denoiser, folder: Path, points: int) -> None:
    """One, two and four passes."""
    noisy, clean = bracket(points)
    panels = [Panel(noisy, "Noisy", distance(noisy, clean))]
    for choice in PASSES:
        after, facts = denoised(denoiser, noisy, iterations=choice)
        print("iterations:", choice, facts, distance(after, clean))
        panels.append(Panel(after, f"iterations={choice}", distance(after, clean)))
    render_panels(panels, folder / "iterations.png", size=SIZE, inset=False)
    shrink(folder / "iterations.png")


def main() -> None:
    """Draw what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", default=",".join(PICTURES))
    parser.add_argument("--points", type=int, default=8_000, help="of the bracket")
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    wanted = arguments.only.split(",")
    if unknown := set(wanted) - set(PICTURES):
        parser.error(f"there is no picture {', '.join(sorted(unknown))}; there are {', '.join(PICTURES)}")
    denoiser = Denoiser.load(device="cpu")
    if "scan" in wanted:
        scan(denoiser, arguments.folder)
    if "iterations" in wanted:
        iterations(denoiser, arguments.folder, arguments.points)
    if "radius" in wanted:
        radius(denoiser, arguments.folder, arguments.points)


if __name__ == "__main__":
    main()
