"""The command ``pcdnf render``: clouds before and after, and a map of displacement or error, as a PNG."""

from __future__ import annotations

import argparse
import re
from pathlib import Path
from typing import TYPE_CHECKING

from .camera import UPS, VIEWS
from .errors import PcdnfError
from .file_formats import titles

if TYPE_CHECKING:
    from .formats import PointCloud
    from .render import Panel

    Subparsers = argparse._SubParsersAction[argparse.ArgumentParser]

SIZES = (160, 16_000)
"""Fewest and most pixels of a side."""


def add_render(subparsers: Subparsers) -> None:
    """Add the command ``render``."""
    parser = subparsers.add_parser(
        "render",
        help="draw clouds as a PNG, with a map of displacement or error",
        description="Draw a cloud, or one before and after, and how far each point moved (or, with --clean, how far "
        "each is from the clean surface), in the unit of the file. Needs no display and no GPU.",
    )
    parser.add_argument("before", type=Path, help=titles())
    parser.add_argument("after", type=Path, nargs="?", help="the same points, denoised")
    parser.add_argument("-o", "--output", type=Path, required=True, help="the PNG")
    parser.add_argument("--clean", type=Path, help="the clean cloud, for a map of the error")
    parser.add_argument(
        "--map",
        choices=["auto", "displacement", "error", "none"],
        default="auto",
        help="auto: error with --clean, else displacement where there are two clouds of the same points",
    )
    parser.add_argument("--title", help="a line of its own (the name of the file)")
    parser.add_argument("--labels", nargs="+", metavar="LABEL", help="in place of Before and After")
    parser.add_argument("--unit", default="", metavar="U", help="of the file's coordinates, as mm, for the legend")
    parser.add_argument("--view", choices=["auto", *VIEWS], default="auto", help="where it is seen from (%(default)s)")
    parser.add_argument("--up", choices=UPS, help="the axis that points up, as in --up=-y (guessed)")
    parser.add_argument("--size", type=_size, metavar="WxH", help="pixels of the picture (1600x900; more with maps)")
    parser.add_argument("--plain", action="store_true", help="clay in place of the file's colours")
    parser.add_argument("--no-detail", action="store_true", help="leave the magnified detail out")
    parser.set_defaults(run=_render)


def _size(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d+)x(\d+)", text, re.ASCII)
    if not found or not all(SIZES[0] <= int(side) <= SIZES[1] for side in found.groups()):
        raise argparse.ArgumentTypeError(f"must look like 1600x900, each from {SIZES[0]} to {SIZES[1]}")
    return int(found[1]), int(found[2])


def _render(options: argparse.Namespace) -> int:
    from .commands import check_writable, read_any

    check_writable(options.output)
    clouds = [read_any(path) for path in (options.before, options.after) if path is not None]
    clean = None if options.clean is None else read_any(options.clean)
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


def draw(
    path: Path,
    clouds: list[PointCloud],
    *,
    clean: PointCloud | None = None,
    kind: str = "auto",
    labels: list[str] | None = None,
    unit: str = "",
    **options: object,
) -> None:
    """Draw one cloud or two, and their map.

    Parameters
    ----------
    path : Path
        Of the PNG.
    clouds : list of PointCloud
        One, or before and after.
    clean : PointCloud, optional
        For a map of the error.
    kind : {"auto", "displacement", "error", "none"}
    labels : list of str, optional
    unit : str
        Of the coordinates, for the legend.
    **options
        Of :func:`pcdnf.render.render_panels`.

    Raises
    ------
    PcdnfError
        Where the map cannot be made of these clouds, or the PNG cannot be written.
    """
    from .render import Panel, render_panels

    labels = labels or (["Before", "After"] if len(clouds) == 2 else ["Cloud"])
    if len(labels) != len(clouds):
        raise PcdnfError(
            f"{len(labels)} labels do not fit {len(clouds)} clouds.", code="usage", hint="Give one for each cloud."
        )
    panels = [Panel(cloud, label, f"{len(cloud):,} points") for cloud, label in zip(clouds, labels, strict=True)]
    panels += _maps(clouds, clean, kind, labels, unit)
    try:
        render_panels(panels, path, **options)  # type: ignore[arg-type]
    except OSError as error:
        raise PcdnfError(
            f"{path} cannot be written: {error.strerror or type(error).__name__}.",
            code="unwritable_file",
            hint="Check its folder's permissions and the space left.",
        ) from error


def _maps(clouds: list[PointCloud], clean: PointCloud | None, kind: str, labels: list[str], unit: str) -> list[Panel]:
    from .maps import Scale, described, displacement, error
    from .render import Panel

    pair = len(clouds) == 2
    if kind == "auto":
        same = pair and len(clouds[0]) == len(clouds[1])
        kind = "error" if clean is not None else "displacement" if same else "none"
    if kind == "none":
        return []
    of = unit or "the file's unit"
    if kind == "displacement":
        if not pair:
            raise PcdnfError("Displacement is between two clouds.", code="usage", hint="Name the denoised one as well.")
        values = [displacement(*clouds)]
        names, legend, shown = ["Displacement"], f"moved by, in {of}", clouds[1:]
    else:
        if clean is None:
            raise PcdnfError("The error is to a clean cloud.", code="usage", hint="Name it with --clean.")
        values = [error(cloud, clean) for cloud in clouds]
        names, legend, shown = (
            [f"{label}: error" for label in labels],
            f"distance to the clean surface, in {of}",
            clouds,
        )
    scale = Scale.of(*values)
    return [
        Panel(cloud, name, described(value), value, scale, legend)
        for cloud, name, value in zip(shown, names, values, strict=True)
    ]
