"""Points far from all others, such as a scanner leaves between an edge and what lies behind it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..formats import PointCloud

NEIGHBOURS = 16
"""Neighbours whose distances tell how lonely a point is."""
FAR = 4.0
"""An outlier's mean distance to its neighbours is more than this many times theirs."""
CHUNK = 65536
"""Points queried at once."""


def outlier_rows(points: NDArray[np.floating]) -> NDArray[np.int64]:
    """Rows of outliers: lonely against their own neighbours, so that a sparse side of a scan is none.

    Parameters
    ----------
    points : ndarray, (N, 3) float

    Returns
    -------
    ndarray, (D,) int64
        Ascending.
    """
    located: NDArray[np.float64] = np.ascontiguousarray(points, np.float64)
    if len(located) < 2:
        return np.empty(0, np.int64)
    count = min(NEIGHBOURS + 1, len(located))
    tree = cKDTree(located)
    index = np.empty((len(located), count - 1), np.int32)
    lonely = np.empty(len(located), np.float32)
    for start in range(0, len(located), CHUNK):
        stop = start + CHUNK
        distance, found = tree.query(located[start:stop], count, workers=-1)
        index[start:stop], lonely[start:stop] = found[:, 1:], distance[:, 1:].mean(1)
    apart = lonely > 0
    if not apart.any():
        return np.empty(0, np.int64)
    whole = np.median(lonely[apart])
    # Copies of one point say nothing about how far apart points are.
    usual = np.median(np.where(apart, lonely, whole)[index], axis=1)
    # A pair of outliers are each other's neighbours: they are also far by the measure of the whole cloud.
    limit = FAR * np.minimum(usual, 3 * whole)
    return np.flatnonzero(lonely > limit)


def drop_outliers(cloud: PointCloud) -> PointCloud:
    """Return the cloud without its outliers; `dropped` and a warning name their rows in the file."""
    rows = outlier_rows(cloud.points)
    return cloud.without(rows, "Outliers") if len(rows) else cloud
