"""Whether the signs of given normals tell the sides of a surface apart."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

SAMPLE, NEIGHBOURS = 2048, 9
"""Points that are looked at, and how many of their nearest, the point itself among them."""
PARALLEL = 0.7
"""Cosine of two normals, up to sign, from which on they count as parallel."""
FEW, ONE_WAY = 0.1, 0.5
"""Share of opposed pairs that a well oriented cloud has at most, and how far the others must lie behind one another."""


def tell_sides(points: NDArray[np.float64], normals: NDArray[np.floating], tree: cKDTree) -> bool:
    """Whether neighbours' normals agree, or else face away from one another across a thin wall.

    Parameters
    ----------
    points : ndarray, (N, 3) float64
    normals : ndarray, (N, 3) float
        Of unit length; zero where there is none.
    tree : cKDTree
        Of the points.

    Returns
    -------
    bool
        False for normals whose signs are those of a principal component analysis.
    """
    rows = np.linspace(0, len(points) - 1, min(len(points), SAMPLE)).astype(np.int64)
    _, index = tree.query(points[rows], min(NEIGHBOURS, len(points)))
    index = np.asarray(index).reshape(len(rows), -1)[:, 1:]
    own = normals[rows][:, None].astype(np.float64)
    cosine = (normals[index] * own).sum(-1)
    opposed = cosine < -PARALLEL
    parallel = np.abs(cosine) > PARALLEL
    if parallel.sum() < SAMPLE // 64:
        return False
    if opposed.sum() <= FEW * parallel.sum():
        return True
    behind = ((points[index] - points[rows][:, None]) * own).sum(-1)[opposed] < 0
    return bool(abs(2 * behind.mean() - 1) > ONE_WAY)
