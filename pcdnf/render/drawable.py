"""A cloud made ready to be drawn: its points with normals, colours and covering discs, and one shaded picture of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pictures
from scipy.spatial import cKDTree

from ..formats import PointCloud
from ..geometry.normals import pca_normals
from .camera import Camera, Floats
from .splats import Image, draw

MOST_DRAWN = 2_000_000
"""Points drawn of each cloud; of larger clouds a fixed random choice."""
OVERSAMPLING = 2
"""Pixels computed along each side of a pixel of the picture."""
NORMAL_NEIGHBOURS = 24
"""Neighbours of estimated normals."""
_COVERING_NEIGHBOURS = 6
_OVERLAP = 1.1
"""Discs reach past this neighbour: 1 pixel in 1 000 of a randomly sampled surface stays open."""
_SPARSE = 1.7
"""Largest disc in typical radii; wider discs would look like noise."""
_TOP, _BOTTOM = (0.020, 0.026, 0.036), (0.055, 0.066, 0.085)
"""Linear light of the background at its top and bottom."""


@dataclass(frozen=True)
class Drawable:
    """What is drawn of a cloud of N points: D of them, D <= ``MOST_DRAWN``.

    Attributes
    ----------
    chosen : slice or ndarray, (D,) int64
        Rows of the cloud.
    points, normals : ndarray, (D, 3) float64
        Normals of unit length.
    colours : ndarray, (D, 3) float32, optional
        Linear light; clay without it.
    radius : ndarray, (D,) float64
        Of the discs, in the unit of the points.
    """

    chosen: Any
    points: Floats
    normals: Floats
    colours: Image | None
    radius: Floats

    @classmethod
    def of(cls, cloud: PointCloud, coloured: bool) -> Drawable:
        """Prepare a cloud; ``coloured`` keeps its own colours."""
        chosen: Any = slice(None)
        if len(cloud) > MOST_DRAWN:
            chosen = np.sort(np.random.default_rng(0).choice(len(cloud), MOST_DRAWN, replace=False))
        points = cloud.points[chosen].astype(np.float64)
        stored = cloud.normals
        normals = pca_normals(points, NORMAL_NEIGHBOURS) if stored is None else stored[chosen]
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        unit = np.divide(normals, length, out=np.tile([0.0, 0.0, 1.0], (len(points), 1)), where=length > 0)
        colours = _colours(cloud) if coloured else None
        return cls(chosen, points, unit, None if colours is None else colours[chosen], _covering_radius(points))

    def thinned(self, most: int) -> tuple[Floats, Floats]:
        """Points and normals of at most about ``most`` points, evenly chosen."""
        step = max(1, len(self.points) // most)
        return self.points[::step], self.normals[::step]

    def picture(self, camera: Camera, height: int, width: int, shading: float = 1.0) -> Pictures.Image:
        """Draw an anti-aliased picture; ``shading`` as in :func:`pcdnf.render.splats.draw`."""
        tall, wide = height * OVERSAMPLING, width * OVERSAMPLING
        ramp = np.linspace(0, 1, tall)[:, None, None]
        background = np.broadcast_to(np.asarray(_TOP) * (1 - ramp) + np.asarray(_BOTTOM) * ramp, (tall, wide, 3))
        backdrop = background.astype(np.float32)
        light = draw(
            self.points, self.normals, self.colours, self.radius, camera, tall, wide, backdrop, shading=shading
        )
        mean = np.clip(light, 0, 1).reshape(height, OVERSAMPLING, width, OVERSAMPLING, 3).mean(axis=(1, 3))
        return Pictures.fromarray((mean ** (1 / 2.2) * 255 + 0.5).astype(np.uint8))


def _colours(cloud: PointCloud) -> Image | None:
    """Return a cloud's own colours in linear light."""
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


def _covering_radius(points: Floats) -> Floats:
    """Radii of discs that close the surface: wider where points are sparse, within reason."""
    count = min(_COVERING_NEIGHBOURS + 1, len(points))
    distance, _ = cKDTree(points).query(points, [count], workers=-1)
    typical = float(np.median(distance)) or float(distance.mean()) or 1.0
    radius: Floats = _OVERLAP * np.clip(distance[:, 0], typical, _SPARSE * typical)
    return radius
