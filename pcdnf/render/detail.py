"""The magnified detail of a picture: its place in the cloud and in the picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from PIL import Image as Pictures
from PIL import ImageDraw
from scipy.ndimage import uniform_filter

from .camera import Camera
from .drawable import Drawable
from .splats import visible

ZOOM = 5.0
LENS, MARGIN = 0.30, 0.045
"""Side of the magnified square and distance from the border, in picture heights."""
ACCENT = (110, 200, 255)
"""Colour of its frame."""


@dataclass(frozen=True)
class Detail:
    """A place that is shown magnified.

    Attributes
    ----------
    column, row : float
        The place, in picture heights from the middle.
    corner : (left, top)
        Where the magnified view goes, in picture heights from the top left.
    """

    column: float
    row: float
    corner: tuple[float, float]


def find_detail(cloud: Drawable, camera: Camera, height: int, width: int) -> Detail:
    """Find where the surface turns most inside a window, and the corner that covers least of the cloud."""
    tall, wide = height // 4, width // 4
    facing = camera.facing(cloud.normals)
    index, _ = visible(cloud.points, facing, cloud.radius, camera, tall, wide)
    drawn = (index >= 0).astype(np.float64)
    side, margin = int(tall * LENS), int(tall * MARGIN)
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
    return Detail((column - wide / 2) / tall, (row - tall / 2) / tall, (corner[0] / tall, corner[1] / tall))


def paste_detail(panel: Pictures.Image, cloud: Drawable, camera: Camera, detail: Detail) -> None:
    """Paste the magnified detail into a panel, framed, and mark its place."""
    width, height = panel.size
    side = int(height * LENS)
    lens = cloud.picture(camera.zoomed(detail.column, detail.row, ZOOM * height / side), side, side)
    column, row = width / 2 + detail.column * height, height / 2 + detail.row * height
    reach = side / ZOOM / 2
    left, top = (int(part * height) for part in detail.corner)
    pen = ImageDraw.Draw(panel)
    pen.rectangle([column - reach, row - reach, column + reach, row + reach], outline=ACCENT, width=2)
    panel.paste(lens, (left, top))
    pen.rectangle([left - 2, top - 2, left + side + 1, top + side + 1], outline=ACCENT, width=2)
