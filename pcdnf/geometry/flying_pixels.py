"""Mixed and flying pixels: points between two surfaces, along the ray of the scanner.

A beam or pixel that straddles an edge measures a mean of the surface in front and the one behind. Seen from the
scanner, such a point has a nearer neighbour and a farther one, and hardly any at its own distance. A wire or a pole
has no nearer neighbour, so it is safe.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

NEIGHBOURS, CLOSEST = 12, 8
"""Neighbours by direction that may lie on the point's surface, and those of them that show what is beside it."""
SLOPE = 3.0
"""Depth over width up to which two neighbours may lie on one surface: a beam that meets it at 72 degrees."""
STEEP = 4.0
"""Depth over width beyond which a neighbour lies in front or behind."""
MOST_ALONG = 3
"""Neighbours on the same surface that a flying pixel has at most."""
LEAST_APART = 0.7
"""Least width between neighbours, in what is usual around: nearly equal directions make no slope."""
NEAR, CROWDED = 4, 2.5
"""A point whose so manyth neighbour in space is within so many widths has a surface, as other stations may show."""
FEWEST = 50
"""Points of a scanner's position below which directions say nothing."""
_CHUNK = 65536


def flying_pixels(points: NDArray[np.float64], sensors: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Find the points that lie between two surfaces, seen from where they were measured.

    Parameters
    ----------
    points : ndarray, (N, 3) float64
        Distinct.
    sensors : ndarray, (N, 3) float64
        Position of the scanner that measured each point; NaN where it is not known.

    Returns
    -------
    ndarray, (N,) bool
        False where the position is not known, or is that of few points.
    """
    flying = np.zeros(len(points), bool)
    known = np.flatnonzero(np.isfinite(sensors).all(1))
    places, station = np.unique(sensors[known], axis=0, return_inverse=True)
    order, counts = np.argsort(station.ravel(), kind="stable"), np.bincount(station.ravel(), minlength=len(places))
    stop, tree = np.cumsum(counts), cKDTree(points)
    for each in np.flatnonzero(counts >= FEWEST):
        rows = known[order[stop[each] - counts[each] : stop[each]]]
        flying[rows] = _between_surfaces(points, rows, places[each], tree)
    return flying


def _between_surfaces(
    points: NDArray[np.float64], own: NDArray[np.int64], place: NDArray[np.float64], space: cKDTree
) -> NDArray[np.bool_]:
    """Which points (M,) of rows ``own`` (M,), seen from one ``place`` (3,), lie between two surfaces."""
    ways = points[own] - place
    distance = np.linalg.norm(ways, axis=1)
    direction = ways / np.maximum(distance, 1e-300)[:, None]
    tree = cKDTree(direction)
    between = np.empty(len(ways), bool)
    for start in range(0, len(ways), _CHUNK):
        rows = slice(start, start + _CHUNK)
        angle, index = tree.query(direction[rows], NEIGHBOURS + 1, workers=-1)
        angle, index = angle[:, 1:], index[:, 1:]
        usual = np.median(angle[:, :CLOSEST], axis=1, keepdims=True)
        here, other = distance[rows, None], distance[index]
        width = np.maximum(angle, LEAST_APART * usual) * np.minimum(here, other)
        depth = other - here
        along = (np.abs(depth) < SLOPE * width).sum(1)
        beside, limit = depth[:, :CLOSEST], STEEP * width[:, :CLOSEST]
        between[rows] = (along <= MOST_ALONG) & (beside < -limit).any(1) & (beside > limit).any(1)
        at = start + np.flatnonzero(between[rows])
        reach = space.query(points[own[at]], [NEAR + 1], workers=-1)[0][:, 0]
        between[at] = reach > CROWDED * usual[at - start, 0] * distance[at]
    return between
