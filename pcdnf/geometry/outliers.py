"""Outliers: points far from all others, flying pixels between two surfaces, and floaters beside a surface."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from ..formats import PointCloud
from ..formats.attributes import with_columns
from .distinct import distinct_points
from .floaters import floaters
from .flying_pixels import flying_pixels

Treatment = Literal["keep", "drop", "mark"]

COLUMN = "outlier"
"""The column that `mark` adds: 1 for an outlier, else 0."""
NEIGHBOURS = 16
"""Neighbours whose distances tell how lonely a point is."""
FAR = 4.0
"""An outlier's mean distance to its neighbours is more than this many times theirs."""
STRAIGHT, ON_LINE, BESIDE = 0.97, 0.5, 4.0
"""A wire: share of the variance along a line that four neighbours have, and how far the point may be from the line and
along it, in standard deviations of the four along it."""
CHUNK = 65536
"""Points queried at once."""


def outlier_rows(points: NDArray[np.floating], sensors: ArrayLike | None = None) -> NDArray[np.int64]:
    """Rows of outliers.

    Lonely points count against their own neighbours, so that a sparse side of a scan is none. Points in line with
    their neighbours belong to a wire and stay. See :mod:`~pcdnf.geometry.flying_pixels` and
    :mod:`~pcdnf.geometry.floaters` for the other kinds.

    Parameters
    ----------
    points : ndarray, (N, 3) float
        Copies of a point count once. Rows of zeros, where there are several, are pixels without a return: no outliers.
    sensors : array_like, (3,) or (N, 3) float, optional
        Where the scanner stood, for all or each of the points; NaN where it is not known.

    Returns
    -------
    ndarray, (D,) int64
        Ascending.
    """
    located: NDArray[np.float64] = np.ascontiguousarray(points, np.float64)
    distinct = distinct_points(located)
    own = located[distinct.rows]
    found = _lonely(own) | floaters(own)
    if sensors is not None:
        places = np.broadcast_to(np.asarray(sensors, np.float64), located.shape)
        found |= flying_pixels(own, places[distinct.rows])
    return np.flatnonzero(np.append(found, False)[distinct.of])


def _lonely(points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which of distinct points (N, 3) are much farther from their neighbours than these are from theirs."""
    if len(points) < 2:
        return np.zeros(len(points), bool)
    count = min(NEIGHBOURS + 1, len(points))
    tree = cKDTree(points)
    index = np.empty((len(points), count - 1), np.int32)
    lonely = np.empty(len(points))
    for start in range(0, len(points), CHUNK):
        stop = start + CHUNK
        distance, found = tree.query(points[start:stop], count, workers=-1)
        index[start:stop], lonely[start:stop] = found[:, 1:], distance[:, 1:].mean(1)
    usual = np.median(lonely[index], axis=1)
    # A pair of outliers are each other's neighbours: they are also far by the measure of the whole cloud.
    far = lonely > FAR * np.minimum(usual, 3 * np.median(lonely))
    rows = np.flatnonzero(far)
    far[rows] = ~_in_line(points[rows], points[index[rows, :4]])
    return np.asarray(far)


def _in_line(points: NDArray[np.float64], neighbours: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which points (N, 3) continue the straight line of their four neighbours (N, 4, 3)."""
    if not len(points) or neighbours.shape[1] < 4:
        return np.zeros(len(points), bool)
    middle = neighbours.mean(1)
    centred = neighbours - middle[:, None]
    variance, axes = np.linalg.eigh(centred.transpose(0, 2, 1) @ centred / 4)
    spread, way = np.sqrt(variance[:, 2]), points - middle
    along = np.abs((way * axes[:, :, 2]).sum(1))
    beside = np.sqrt(np.maximum((way**2).sum(1) - along**2, 0))
    straight = variance[:, 2] >= STRAIGHT * variance.sum(1)
    return np.asarray(straight & (beside <= ON_LINE * spread) & (along <= BESIDE * spread))


def treat_outliers(cloud: PointCloud, how: Treatment, sensors: ArrayLike | None = None) -> PointCloud:
    """Return the cloud with its outliers kept, dropped or marked.

    Parameters
    ----------
    cloud : PointCloud
    how : {"keep", "drop", "mark"}
        `drop` leaves them out; ``dropped`` and a warning name their rows in the file. `mark` adds a column of uint8,
        ``outlier``.
    sensors : array_like, (3,) or (N, 3) float, optional
        See :func:`outlier_rows`.
    """
    if how == "keep":
        return cloud
    rows = outlier_rows(cloud.points, sensors)
    if how == "drop":
        return cloud.without(rows, "Outliers") if len(rows) else cloud
    column = np.zeros(len(cloud), np.uint8)
    column[rows] = 1
    return with_columns(cloud, {COLUMN: column})


def drop_outliers(cloud: PointCloud, sensors: ArrayLike | None = None) -> PointCloud:
    """Return the cloud without its outliers; `dropped` and a warning name their rows in the file."""
    return treat_outliers(cloud, "drop", sensors)
