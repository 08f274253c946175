"""The command ``pcdnf render``: clouds before and after, and a map of displacement or error, as a PNG."""

from __future__ import annotations

import argparse
import re
from pathlib import Path
from typing import TYPE_CHECKING

from ..file_formats import titles
from ..render.views import UPS, VIEWS
from .common import check_writable

if TYPE_CHECKING:
    Subparsers = argparse._SubParsersAction[argparse.ArgumentParser]


SIZES = (160, 16_000)
"""Fewest and most pixels of a side."""


def add_render(subparsers: Subparsers) -> None:
    """Add the command ``render``."""
    parser = subparsers.add_parser(
        "render",
        help="draw clouds as a PNG, with a map of displacement or error",
        description="Draw one cloud, or a cloud before and after denoising with a map of how far each point moved. "
        "With --clean the map shows the distance to the clean surface. No display and no GPU are needed.",
    )
    parser.add_argument("before", type=Path, help=f"the cloud: {titles()}")
    parser.add_argument("after", type=Path, nargs="?", help="the same cloud after denoising")
    parser.add_argument("-o", "--output", type=Path, required=True, help="the PNG to write")
    parser.add_argument("--clean", type=Path, help="the clean cloud, for a map of the error")
    parser.add_argument(
        "--map",
        choices=["auto", "displacement", "error", "none"],
        default="auto",
        help="auto draws the error with --clean, else the displacement if both clouds have the same points",
    )
    parser.add_argument("--title", help="line of text below the picture (default: the file's name)")
    parser.add_argument("--labels", nargs="+", metavar="LABEL", help="one label per cloud (default: Before and After)")
    parser.add_argument("--unit", default="", metavar="U", help="unit of the coordinates, such as mm, for the legend")
    parser.add_argument("--view", choices=["auto", *VIEWS], default="auto", help="viewpoint (default: %(default)s)")
    parser.add_argument("--up", choices=UPS, help="axis that points up, such as --up=-y (default: guessed)")
    parser.add_argument(
        "--size", type=_size, metavar="WxH", help="size in pixels (default: 1600x900, larger with maps)"
    )
    parser.add_argument("--plain", action="store_true", help="draw in clay instead of the file's colours")
    parser.add_argument("--no-detail", action="store_true", help="omit the magnified detail")
    parser.set_defaults(run=_render)


def _size(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d+)x(\d+)", text, re.ASCII)
    if not found or not all(SIZES[0] <= int(side) <= SIZES[1] for side in found.groups()):
        raise argparse.ArgumentTypeError(f"must look like 1600x900, each from {SIZES[0]} to {SIZES[1]}")
    return int(found[1]), int(found[2])


def _render(options: argparse.Namespace) -> int:
    from ..formats.files import read
    from ..render.figure import draw

    check_writable(options.output)
    clouds = [read(path) for path in (options.before, options.after) if path is not None]
    clean = None if options.clean is None else read(options.clean)
    draw(
        options.output,
        clouds,
        clean=clean,
        kind=options.map,
        labels=options.labels,
        title=options.before.name if options.title is None else options.title,
        unit=options.unit,
        size=options.size,
        view=None if options.view == "auto" else options.view,
        up=options.up,
        inset=not options.no_detail,
        coloured=not options.plain,
    )
    return 0
