"""Pictures of clouds as a PNG, before and after and as maps, drawn with numpy and Pillow alone."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pictures
from PIL import ImageDraw, ImageFont
from scipy.ndimage import uniform_filter
from scipy.spatial import cKDTree

from ..formats import PointCloud
from ..geometry.normals import pca_normals
from .camera import Camera, Floats, automatic, named
from .colour_maps import ColourScale, draw_legend
from .splats import Image, draw, visible

MOST_DRAWN = 2_000_000
"""Points drawn of each cloud; of larger ones a fixed random choice."""
OVERSAMPLING = 2
NORMAL_NEIGHBOURS = 24
ZOOM = 5.0
MAP_SHADING = 0.35
"""Enough to see the shape, little enough to compare the colours with the legend."""
DEFAULT_SIZES = {1: (1000, 900), 2: (1600, 900), 3: (2250, 900), 4: (1600, 1500)}
"""Pixels, by the number of panels."""

_COVERING_NEIGHBOURS = 6
_OVERLAP = 1.1
"""Discs reach past this neighbour: 1 pixel in 1 000 of a randomly sampled surface stays open."""
_SPARSE = 1.7
"""Most times the typical radius; wider discs would be taken for noise."""
_LENS, _MARGIN = 0.30, 0.045
"""In picture heights."""
_TOP, _BOTTOM = (0.020, 0.026, 0.036), (0.055, 0.066, 0.085)
_FILL, _FILL_BESIDE_LEGEND = 0.80, 0.58
"""Part of a panel's height that the cloud takes; of its width it is the first."""
_RULE = (70, 80, 96)
_WHITE, _GREY, _ACCENT = (244, 246, 250), (160, 170, 185), (110, 200, 255)


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


@dataclass(frozen=True)
class _Drawable:
    chosen: Any
    points: Floats
    normals: Floats
    colours: Image | None
    radius: Floats


@dataclass(frozen=True)
class _Detail:
    """A place (picture heights from the middle) and the corner its magnified view goes to (from the top left)."""

    column: float
    row: float
    corner: tuple[float, float]


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
    drawn: dict[int, _Drawable] = {}
    for panel in panels[::-1]:
        if id(panel.cloud) not in drawn:
            drawn[id(panel.cloud)] = _drawable(panel.cloud, coloured)
    subject = drawn[id(panels[-1].cloud)]
    shown = [drawn[id(panel.cloud)] for panel in panels]
    if len({len(panel.cloud) for panel in panels}) == 1:
        shown = [replace(cloud, radius=subject.radius) for cloud in shown]
    if isinstance(view, Camera):
        camera = view
    elif view is None:
        camera = automatic(*_thinned(subject, 20_000), up)
    else:
        camera = named(view, up or "y", subject.points)
    legend = any(panel.values is not None for panel in panels)
    fill = _FILL_BESIDE_LEGEND if legend else _FILL
    camera = camera.framing(subject.points, width / height * 0.95 * _FILL / fill, fill)
    detail = _detail(subject, camera, height, width) if inset else None
    picture = Pictures.new("RGB", (columns * width, rows * height))
    for place, (panel, cloud) in enumerate(zip(panels, shown, strict=True)):
        if panel.values is not None and panel.scale is not None:
            cloud = replace(cloud, colours=panel.scale.colours(panel.values[cloud.chosen]))
        part = _panel(cloud, camera, height, width, MAP_SHADING if panel.values is not None else 1.0)
        _write_label(part, panel.label, panel.caption, _WHITE if place else _GREY)
        if panel.scale is not None:
            draw_legend(part, panel.scale, panel.unit, int(height * _MARGIN), _WHITE)
        elif detail is not None:
            _paste_detail(part, cloud, camera, detail)
        picture.paste(part, (place % columns * width, place // columns * height))
    low_left = detail is not None and detail.corner[0] < _LENS and detail.corner[1] > _LENS
    _finish(picture, title, columns, rows, at_the_right=low_left)
    picture.save(Path(path), format="PNG", optimize=True)


def _drawable(cloud: PointCloud, coloured: bool) -> _Drawable:
    """What is drawn of a cloud: at most ``MOST_DRAWN`` points, with unit normals and linear colours."""
    chosen: Any = slice(None)
    if len(cloud) > MOST_DRAWN:
        chosen = np.sort(np.random.default_rng(0).choice(len(cloud), MOST_DRAWN, replace=False))
    points = cloud.points[chosen].astype(np.float64)
    stored = cloud.normals
    normals = pca_normals(points, NORMAL_NEIGHBOURS) if stored is None else stored[chosen]
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    unit = np.divide(normals, length, out=np.tile([0.0, 0.0, 1.0], (len(points), 1)), where=length > 0)
    colours = _colours(cloud) if coloured else None
    return _Drawable(chosen, points, unit, None if colours is None else colours[chosen], _covering_radius(points))


def _colours(cloud: PointCloud) -> Image | None:
    """A cloud's own colours in linear light."""
    columns = [cloud.attributes.get(name) for name in ("red", "green", "blue")]
    found: NDArray[Any] | None = None
    if all(column is not None and column.ndim == 1 for column in columns):
        found = np.stack([column for column in columns if column is not None], axis=1)
    for name in ("rgb", "colors", "colours", "color"):
        table = cloud.attributes.get(name)
        if found is None and table is not None and table.ndim == 2 and table.shape[1] >= 3:
            found = table[:, :3]
    if found is None:
        return None
    most = float(np.iinfo(found.dtype).max) if found.dtype.kind in "iu" else 1.0
    return np.asarray(np.clip(np.nan_to_num(found / most), 0, 1) ** 2.2, np.float32)


def _thinned(cloud: _Drawable, most: int) -> tuple[Floats, Floats]:
    step = max(1, len(cloud.points) // most)
    return cloud.points[::step], cloud.normals[::step]


def _covering_radius(points: Floats) -> Floats:
    """Radii of discs that close the surface: wider where points are sparse, within reason."""
    count = min(_COVERING_NEIGHBOURS + 1, len(points))
    distance, _ = cKDTree(points).query(points, [count], workers=-1)
    typical = float(np.median(distance)) or float(distance.mean()) or 1.0
    radius: Floats = _OVERLAP * np.clip(distance[:, 0], typical, _SPARSE * typical)
    return radius


def _panel(cloud: _Drawable, camera: Camera, height: int, width: int, shading: float = 1.0) -> Pictures.Image:
    """One panel, anti-aliased."""
    tall, wide = height * OVERSAMPLING, width * OVERSAMPLING
    ramp = np.linspace(0, 1, tall)[:, None, None]
    background = np.broadcast_to(np.asarray(_TOP) * (1 - ramp) + np.asarray(_BOTTOM) * ramp, (tall, wide, 3))
    backdrop = background.astype(np.float32)
    light = draw(
        cloud.points, cloud.normals, cloud.colours, cloud.radius, camera, tall, wide, backdrop, shading=shading
    )
    mean = np.clip(light, 0, 1).reshape(height, OVERSAMPLING, width, OVERSAMPLING, 3).mean(axis=(1, 3))
    return Pictures.fromarray((mean ** (1 / 2.2) * 255 + 0.5).astype(np.uint8))


def _detail(cloud: _Drawable, camera: Camera, height: int, width: int) -> _Detail:
    """Where the surface turns most inside a window, and the corner that covers least of the cloud."""
    tall, wide = height // 4, width // 4
    facing = camera.facing(cloud.normals)
    index, _ = visible(cloud.points, facing, cloud.radius, camera, tall, wide)
    drawn = (index >= 0).astype(np.float64)
    side, margin = int(tall * _LENS), int(tall * _MARGIN)
    low, right = tall - margin - side, wide - margin - side
    corners = [(right, low), (margin, low), (right, margin)]
    corner = min(corners, key=lambda at: drawn[at[1] : at[1] + side, at[0] : at[0] + side].sum())
    window = int(side / ZOOM) | 1
    share = uniform_filter(drawn, window, mode="constant")
    shown = facing[np.maximum(index, 0)] * drawn[..., None]
    mean = np.stack([uniform_filter(shown[..., axis], window, mode="constant") for axis in range(3)], axis=-1)
    turn = np.where(share > 0.97, share - np.square(mean).sum(axis=-1) / np.maximum(share, 1e-6), -1)
    clear = window
    turn[
        max(corner[1] - clear, 0) : corner[1] + side + clear, max(corner[0] - clear, 0) : corner[0] + side + clear
    ] = -1
    row, column = np.unravel_index(int(np.argmax(turn)), turn.shape)
    return _Detail((column - wide / 2) / tall, (row - tall / 2) / tall, (corner[0] / tall, corner[1] / tall))


def _paste_detail(panel: Pictures.Image, cloud: _Drawable, camera: Camera, detail: _Detail) -> None:
    """A square frame with the detail magnified, and its place marked."""
    width, height = panel.size
    side = int(height * _LENS)
    lens = _panel(cloud, camera.zoomed(detail.column, detail.row, ZOOM * height / side), side, side)
    column, row = width / 2 + detail.column * height, height / 2 + detail.row * height
    reach = side / ZOOM / 2
    left, top = (int(part * height) for part in detail.corner)
    pen = ImageDraw.Draw(panel)
    pen.rectangle([column - reach, row - reach, column + reach, row + reach], outline=_ACCENT, width=2)
    panel.paste(lens, (left, top))
    pen.rectangle([left - 2, top - 2, left + side + 1, top + side + 1], outline=_ACCENT, width=2)


def _write_label(panel: Pictures.Image, label: str, caption: str, colour: tuple[int, int, int]) -> None:
    height = panel.size[1]
    margin = int(height * _MARGIN)
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
        margin = int(tall * _MARGIN)
        foot = height // rows - margin  # of the first row: the maps have their legends at the foot
        column, anchor = (width // columns - margin, "rs") if at_the_right else (margin, "ls")
        pen.text((column, foot), title, fill=_GREY, font=ImageFont.load_default(tall * 0.024), anchor=anchor)
