"""Distinct points of a cloud: copies count once, and rows without a measurement not at all."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Distinct:
    """Which rows of a cloud stand for which points.

    Attributes
    ----------
    rows : ndarray, (M,) int64
        First row of each distinct point, ascending.
    of : ndarray, (N,) int64
        Distinct point of each row; -1 for a row without a measurement.
    """

    rows: NDArray[np.int64]
    of: NDArray[np.int64]

    @property
    def all_rows(self) -> bool:
        """Whether every row is a point by itself."""
        return len(self.rows) == len(self.of)


def void_rows(points: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Rows (N,) of a cloud (N, 3) that are exactly (0, 0, 0), where there is more than one.

    Depth cameras and spinning scanners write pixels without a return so. A single such row may be a point.
    """
    void: NDArray[np.bool_] = np.logical_not(points.any(1))
    return void if void.sum() > 1 else np.zeros(len(points), bool)


def distinct_points(points: NDArray[np.float64]) -> Distinct:
    """Find the distinct points of a cloud.

    Parameters
    ----------
    points : ndarray, (N, 3) float64

    Returns
    -------
    Distinct
    """
    filled = np.flatnonzero(~void_rows(points))
    place = points[filled]
    order = np.lexsort(place.T)  # stable: of equal points the first row comes first
    ordered = place[order]
    new = np.append(True, (ordered[1:] != ordered[:-1]).any(1)) if len(order) else np.empty(0, bool)
    first = filled[order[new]]
    rank = np.empty(len(first), np.int64)
    by_row = np.argsort(first)
    rank[by_row] = np.arange(len(first))
    of = np.full(len(points), -1, np.int64)
    of[filled[order]] = rank[np.cumsum(new) - 1]
    return Distinct(first[by_row], of)
