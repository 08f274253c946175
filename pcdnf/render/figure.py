"""A picture of one or two clouds with a map of displacement or error, as ``pcdnf render`` draws it."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import PcdnfError

if TYPE_CHECKING:
    from ..formats import PointCloud
    from .panels import Panel

    Subparsers = argparse._SubParsersAction[argparse.ArgumentParser]


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
        Of :func:`pcdnf.render.panels.render_panels`.

    Raises
    ------
    PcdnfError
        If the map cannot be made of these clouds, or the PNG cannot be written.
    """
    from .panels import Panel, render_panels

    labels = labels or (["Before", "After"] if len(clouds) == 2 else ["Cloud"])
    if len(labels) != len(clouds):
        raise PcdnfError(
            f"There are {len(labels)} labels for {len(clouds)} clouds.", code="usage", hint="Give one label per cloud."
        )
    panels = [Panel(cloud, label, f"{len(cloud):,} points") for cloud, label in zip(clouds, labels, strict=True)]
    panels += _maps(clouds, clean, kind, labels, unit)
    try:
        render_panels(panels, path, **options)  # type: ignore[arg-type]
    except OSError as error:
        raise PcdnfError(
            f"{path} cannot be written: {error.strerror or type(error).__name__}.",
            code="unwritable_file",
            hint="Check the folder's permissions and the free disk space.",
        ) from error


def _maps(clouds: list[PointCloud], clean: PointCloud | None, kind: str, labels: list[str], unit: str) -> list[Panel]:
    from .colour_maps import ColourScale, described, displacement, error
    from .panels import Panel

    pair = len(clouds) == 2
    if kind == "auto":
        same = pair and len(clouds[0]) == len(clouds[1])
        kind = "error" if clean is not None else "displacement" if same else "none"
    if kind == "none":
        return []
    of = unit or "the file's unit"
    if kind == "displacement":
        if not pair:
            raise PcdnfError(
                "A map of the displacement needs two clouds.", code="usage", hint="Name the denoised one too."
            )
        values = [displacement(*clouds)]
        names, legend, shown = ["Displacement"], f"displacement, in {of}", clouds[1:]
    else:
        if clean is None:
            raise PcdnfError("A map of the error needs the clean cloud.", code="usage", hint="Name it with --clean.")
        values = [error(cloud, clean) for cloud in clouds]
        names, legend, shown = (
            [f"{label}: error" for label in labels],
            f"distance to the clean surface, in {of}",
            clouds,
        )
    scale = ColourScale.of(*values)
    return [
        Panel(cloud, name, described(value), value, scale, legend)
        for cloud, name, value in zip(shown, names, values, strict=True)
    ]
