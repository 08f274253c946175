"""Drawing a point cloud as shaded surface elements on the CPU: no GPU, no display.

Each point is a disc in its tangent plane (a surfel), drawn into a depth buffer; the picture is lit from
the camera's upper left and darkened where depth drops (eye-dome lighting, Boucheny 2009).
"""

from __future__ import annotations

import numba as nb
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
_DOME_STEP = 2
"""Pixels to one of the picture that tells the surroundings' depth."""


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
    slope = facing[inside, :2] / np.maximum(facing[inside, 2:], _STEEPEST) * [1, -1]  # image rows run down
    spare = 8 * float(radius.max()) + 1e-6 * camera.distance
    low, high = float(depth.min()) - spare, float(depth.max()) + spare
    nearest = np.full((height, width), _NOTHING)
    _fill(nearest, inside, column, row, depth, scale, discs, slope, low, high - low)
    index = np.where(nearest == _NOTHING, -1, nearest & ((1 << _INDEX_BITS) - 1))
    return index, (nearest >> _INDEX_BITS) / _DEPTH_STEPS * (high - low) + low


@nb.njit(cache=True, nogil=True)
def _fill(
    nearest: NDArray[np.int64],
    points: NDArray[np.int64],
    column: Floats,
    row: Floats,
    depth: Floats,
    scale: Floats,
    discs: Floats,
    slope: Floats,
    low: float,
    span: float,
) -> None:
    """Put depth and index of each pixel's nearest disc into ``nearest``; ``slope`` has a row for each of ``points``."""
    height, width = nearest.shape
    for place, point in enumerate(points):
        disc = discs[point]
        reach, home_row, home_column = int(disc), int(np.floor(row[point])), int(np.floor(column[point]))
        for y in range(max(home_row - reach, 0), min(home_row + reach + 1, height)):
            for x in range(max(home_column - reach, 0), min(home_column + reach + 1, width)):
                dx, dy = x - home_column, y - home_row
                rise = slope[place, 0] * dx + slope[place, 1] * dy  # of its plane at this pixel, in pixels
                if rise * rise + (dx * dx + dy * dy) <= disc * disc:
                    away = depth[point] + rise / scale[point] - low
                    key = np.int64(away / span * _DEPTH_STEPS) << _INDEX_BITS | point
                    nearest[y, x] = min(nearest[y, x], key)


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
    """Factor that darkens pixels lying behind their surroundings, which a picture of less detail tells."""
    rough_depth, rough_drawn = _reduced(np.where(drawn, depth, 0.0)), _reduced(drawn.astype(np.float64))
    most = np.array(rough_depth.shape)[:, None, None] - 1
    row, column = np.minimum(np.indices(depth.shape) // _DOME_STEP, most)
    shade = np.zeros_like(depth)
    for fraction, weight in ((0.004, 0.5), (0.016, 0.5)):
        sigma = fraction * len(rough_depth)
        mean = gaussian_filter(rough_depth, sigma) / np.maximum(gaussian_filter(rough_drawn, sigma), 1e-6)
        shade += weight * np.clip((depth - mean[row, column]) / (6 * radius), 0, 1)
    return np.asarray(1 - 0.6 * shade)


def _reduced(image: Floats) -> Floats:
    """Mean of blocks of ``_DOME_STEP`` pixels; a rest at the edges is left out, unless there is nothing else."""
    height, width = (max(size // _DOME_STEP, 1) for size in image.shape)
    tall, wide = (min(size, _DOME_STEP * count) for size, count in zip(image.shape, (height, width), strict=True))
    blocks = image[:tall, :wide].reshape(height, tall // height, width, wide // width)
    return np.asarray(blocks.mean(axis=(1, 3)))
