"""Pictures of clouds as a PNG, before and after and as maps, drawn with numpy and Pillow alone."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from PIL import Image as Pictures
from PIL import ImageDraw, ImageFont

from ..formats import PointCloud
from .camera import Camera, Floats, automatic, named
from .colour_maps import ColourScale, draw_legend
from .detail import LENS, MARGIN, find_detail, paste_detail
from .drawable import Drawable

MAP_SHADING = 0.35
"""Shading of maps: enough to show the shape, weak enough to compare colours with the legend."""
DEFAULT_SIZES = {1: (1000, 900), 2: (1600, 900), 3: (2250, 900), 4: (1600, 1500)}
"""Pixels, by the number of panels."""

_FILL, _FILL_BESIDE_LEGEND = 0.80, 0.58
"""Part of a panel's height that the cloud takes; of its width it is the first."""
_RULE = (70, 80, 96)
_WHITE, _GREY = (244, 246, 250), (160, 170, 185)


@dataclass(frozen=True)
class Panel:
    """A cloud of a picture.

    Attributes
    ----------
    cloud : PointCloud
    label, caption : str
        Above it.
    values : (N,) array, optional
        Shown by colour in place of the cloud's own, with ``scale`` and, under its legend, ``unit``.
    """

    cloud: PointCloud
    label: str
    caption: str
    values: Floats | None = None
    scale: ColourScale | None = None
    unit: str = ""


def render_comparison(
    before: PointCloud,
    after: PointCloud,
    path: str | os.PathLike[str],
    *,
    title: str | None = None,
    labels: tuple[str, str] = ("Before", "After"),
    captions: tuple[str, str] | None = None,
    size: tuple[int, int] = (1600, 900),
    camera: Camera | None = None,
    inset: bool = True,
    coloured: bool = True,
) -> None:
    """Draw two clouds side by side, from one camera, and save the picture.

    Parameters
    ----------
    before, after : PointCloud
        Shaded by their normals, or by PCA normals where they have none; in their own colours where
        they have some (red, green, blue or an (N, 3) rgb or colors).
    path : path-like
        Of the PNG.
    title : str, optional
        A line at the foot of the picture.
    labels, captions : pair of str
        Above each half; the captions default to the number of points.
    size : (width, height)
        Pixels of the whole picture.
    camera : Camera, optional
        By default chosen from the shape of ``after``.
    inset : bool
        Whether a detail is shown magnified, the same in both halves.
    coloured : bool
        Whether the clouds' own colours are used; plain clay shows the shape better.
    """
    captions = captions or (f"{len(before):,} points", f"{len(after):,} points")
    panels = [Panel(before, labels[0], captions[0]), Panel(after, labels[1], captions[1])]
    render_panels(panels, path, title=title, size=size, view=camera, inset=inset, coloured=coloured)


def render_panels(
    panels: Sequence[Panel],
    path: str | os.PathLike[str],
    *,
    title: str | None = None,
    size: tuple[int, int] | None = None,
    view: Camera | str | None = None,
    up: str | None = None,
    inset: bool = True,
    coloured: bool = True,
) -> None:
    """Draw clouds beside each other, four of them in two rows, from one camera, and save the picture.

    Parameters
    ----------
    panels : sequence of Panel
        One to four; the view is chosen from the shape of the last.
    path : path-like
        Of the PNG.
    title : str, optional
        A line at the foot of the picture.
    size : (width, height), optional
        Pixels of the whole picture; by default 1600 x 900, wider for three panels and higher for two rows.
    view : Camera or str, optional
        A name of ``pcdnf.render.views.VIEWS``; by default chosen from the shape.
    up : str, optional
        A name of ``pcdnf.render.views.UPS``; by default guessed, and y for a named view.
    inset : bool
        Whether a detail is shown magnified, the same in every panel that is no map.
    coloured : bool
        Whether the clouds' own colours are used; plain clay shows the shape better.
    """
    columns = 2 if len(panels) == 4 else len(panels)
    rows = -(-len(panels) // columns)
    size = size or DEFAULT_SIZES[len(panels)]
    width, height = size[0] // columns, size[1] // rows
    drawn: dict[int, Drawable] = {}
    for panel in panels[::-1]:
        if id(panel.cloud) not in drawn:
            drawn[id(panel.cloud)] = Drawable.of(panel.cloud, coloured)
    subject = drawn[id(panels[-1].cloud)]
    shown = [drawn[id(panel.cloud)] for panel in panels]
    if len({len(panel.cloud) for panel in panels}) == 1:
        shown = [replace(cloud, radius=subject.radius) for cloud in shown]
    if isinstance(view, Camera):
        camera = view
    elif view is None:
        camera = automatic(*subject.thinned(20_000), up)
    else:
        camera = named(view, up or "y", subject.points)
    legend = any(panel.values is not None for panel in panels)
    fill = _FILL_BESIDE_LEGEND if legend else _FILL
    camera = camera.framing(subject.points, width / height * 0.95 * _FILL / fill, fill)
    detail = find_detail(subject, camera, height, width) if inset else None
    picture = Pictures.new("RGB", (columns * width, rows * height))
    for place, (panel, cloud) in enumerate(zip(panels, shown, strict=True)):
        if panel.values is not None and panel.scale is not None:
            cloud = replace(cloud, colours=panel.scale.colours(panel.values[cloud.chosen]))
        part = cloud.picture(camera, height, width, MAP_SHADING if panel.values is not None else 1.0)
        _write_label(part, panel.label, panel.caption, _WHITE if place else _GREY)
        if panel.scale is not None:
            draw_legend(part, panel.scale, panel.unit, int(height * MARGIN), _WHITE)
        elif detail is not None:
            paste_detail(part, cloud, camera, detail)
        picture.paste(part, (place % columns * width, place // columns * height))
    low_left = detail is not None and detail.corner[0] < LENS and detail.corner[1] > LENS
    _finish(picture, title, columns, rows, at_the_right=low_left)
    picture.save(Path(path), format="PNG", optimize=True)


def _write_label(panel: Pictures.Image, label: str, caption: str, colour: tuple[int, int, int]) -> None:
    height = panel.size[1]
    margin = int(height * MARGIN)
    pen = ImageDraw.Draw(panel)
    large, small = ImageFont.load_default(height * 0.042), ImageFont.load_default(height * 0.024)
    pen.text((margin, margin), label, fill=colour, font=large)
    pen.text((margin, margin + height * 0.058), caption, fill=_GREY, font=small)


def _finish(picture: Pictures.Image, title: str | None, columns: int, rows: int, *, at_the_right: bool) -> None:
    width, height = picture.size
    pen = ImageDraw.Draw(picture)
    for column in range(1, columns):
        pen.line([width * column // columns, 0, width * column // columns, height], fill=_RULE, width=2)
    for row in range(1, rows):
        pen.line([0, height * row // rows, width, height * row // rows], fill=_RULE, width=2)
    if title:
        tall = height / rows
        margin = int(tall * MARGIN)
        foot = height // rows - margin  # of the first row: the maps have their legends at the foot
        column, anchor = (width // columns - margin, "rs") if at_the_right else (margin, "ls")
        pen.text((column, foot), title, fill=_GREY, font=ImageFont.load_default(tall * 0.024), anchor=anchor)
