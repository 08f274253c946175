"""Drawing a point cloud as shaded surface elements with numpy: no GPU, no display.

Each point is a disc in its tangent plane (a surfel), drawn into a depth buffer; the picture is lit from
the camera's upper left and darkened where depth drops (eye-dome lighting, Boucheny 2009).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from .camera import Camera

Floats = NDArray[np.float64]
Image = NDArray[np.float32]
"""(height, width, 3) linear light, 0 to 1."""

CLAY = (0.80, 0.71, 0.60)
"""Colour of points that bring none."""

_KEY = np.array([-0.55, 0.62, 0.56])
_FILL = np.array([0.80, 0.10, 0.59])
_SMALLEST_DISC = 0.8
_LARGEST_DISC = 0.12
"""Radii: in pixels, in picture heights."""
_STEEPEST = 0.25
_DEPTH_STEPS = float(2**38)
_INDEX_BITS = 24
_NOTHING = np.iinfo(np.int64).max


def draw(
    points: Floats,
    normals: Floats,
    colours: Image | None,
    radius: Floats,
    camera: Camera,
    height: int,
    width: int,
    background: Image,
    *,
    shading: float = 1.0,
) -> Image:
    """Draw a cloud in front of a background.

    Parameters
    ----------
    points, normals : (N, 3) arrays
        Normals of unit length, of either sign; at most 2**24 points.
    colours : (N, 3) array or None
        Linear light; None is clay.
    radius : (N,) array
        Of the discs, in the unit of the points.
    camera : Camera
    height, width : int
        Pixels of the picture.
    background : (height, width, 3) array
    shading : float
        Of coloured points: 1 is lit as a thing is, 0 shows the colours as they are.
    """
    facing = camera.facing(normals)
    index, depth = visible(points, facing, radius, camera, height, width)
    drawn = index >= 0
    image = background.copy()
    lit = _lit(facing[index[drawn]], None if colours is None else colours[index[drawn]], shading)
    dome = 1 - shading + shading * _dome(depth, drawn, float(np.median(radius)))
    image[drawn] = lit * dome[drawn][:, None]
    return image


def visible(
    points: Floats, facing: Floats, radius: Floats, camera: Camera, height: int, width: int
) -> tuple[NDArray[np.int64], Floats]:
    """Find the nearest point of each pixel (-1: none) and its depth.

    ``facing`` are normals in camera axes, turned towards the eye; the rest is as in :func:`draw`.
    """
    column, row, depth = camera.project(points, height, width)
    scale = camera.focal * height / depth
    discs = np.clip(radius * scale, _SMALLEST_DISC, _LARGEST_DISC * height)
    reach = int(np.ceil(discs.max()))
    inside = np.flatnonzero((column > -reach) & (column < width + reach) & (row > -reach) & (row < height + reach))
    order = inside[np.argsort(-discs[inside])]
    column, row, near, scale, discs = column[order], row[order], depth[order], scale[order], discs[order]
    slope = facing[order, :2] / np.maximum(facing[order, 2:], _STEEPEST) * [1, -1]  # image rows run down
    spare = 8 * float(radius.max()) + 1e-6 * camera.distance
    low, high = float(depth.min()) - spare, float(depth.max()) + spare
    # a margin of 2 x reach, so that no disc leaves the buffer
    wide = width + 4 * reach
    nearest = np.full((height + 4 * reach) * wide, _NOTHING)
    home = (np.floor(row).astype(np.int64) + 2 * reach) * wide + np.floor(column).astype(np.int64) + 2 * reach
    for dy in range(-reach, reach + 1):
        for dx in range(-reach, reach + 1):
            count = int(np.searchsorted(-discs, -np.hypot(dx, dy), side="right"))  # discs that reach so far
            rise = slope[:count, 0] * dx + slope[:count, 1] * dy  # of their planes at this pixel, in pixels
            chosen = np.flatnonzero(rise * rise + (dx * dx + dy * dy) <= np.square(discs[:count]))
            plane = near[chosen] + rise[chosen] / scale[chosen]
            key = ((plane - low) / (high - low) * _DEPTH_STEPS).astype(np.int64) << _INDEX_BITS | order[chosen]
            np.minimum.at(nearest, home[chosen] + (dy * wide + dx), key)
    nearest = nearest.reshape(-1, wide)[2 * reach : 2 * reach + height, 2 * reach : 2 * reach + width]
    index = np.where(nearest == _NOTHING, -1, nearest & ((1 << _INDEX_BITS) - 1))
    return index, (nearest >> _INDEX_BITS) / _DEPTH_STEPS * (high - low) + low


def _lit(facing: Floats, colours: Image | None, shading: float) -> Image:
    """Linear light of points by their normals in camera axes."""
    key, fill = _KEY / np.linalg.norm(_KEY), _FILL / np.linalg.norm(_FILL)
    half = key + np.array([0, 0, 1])
    half /= np.linalg.norm(half)
    diffuse = np.maximum(facing @ key, 0)[:, None] * [1.0, 0.96, 0.90] * 0.82
    diffuse = diffuse + np.maximum(facing @ fill, 0)[:, None] * [0.55, 0.70, 1.0] * 0.22
    diffuse = diffuse + (0.5 + 0.5 * facing[:, 1:2]) * [0.80, 0.90, 1.0] * 0.16
    if colours is not None:
        return np.asarray(colours * (1 - shading + shading * (0.40 + 0.60 * diffuse)), np.float32)
    gloss = np.maximum(facing @ half, 0)[:, None] ** 40 * 0.16
    albedo = np.asarray(CLAY) ** 2.2
    return np.asarray(albedo * diffuse * 1.25 + gloss, np.float32)


def _dome(depth: Floats, drawn: NDArray[np.bool_], radius: float) -> Floats:
    """Factor that darkens pixels lying behind their surroundings."""
    shade = np.zeros_like(depth)
    for fraction, weight in ((0.004, 0.5), (0.016, 0.5)):
        sigma = fraction * len(depth)
        mass = gaussian_filter(drawn.astype(np.float64), sigma)
        mean = gaussian_filter(np.where(drawn, depth, 0.0), sigma) / np.maximum(mass, 1e-6)
        shade += weight * np.clip((depth - mean) / (6 * radius), 0, 1)
    return np.asarray(1 - 0.6 * shade)
