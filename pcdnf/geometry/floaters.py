"""Points that hover beside a surface, alone or in small clusters, told by noise and spacing around them.

This works where the sampling is even and resolves the surface: multiple views merged, photogrammetry. Scanners that
turn sample far things thinly, and wires and twigs there look like floaters. Their clouds are left to the other rules.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from .local_scale import LocalScale, estimate_local_scale
from .morton import spatial_order

FEWEST = 1000
"""Points of a cloud below which its spacing is not known well enough."""
EVEN = 2.0
"""Spacing of the sparse tenth over that of the dense tenth, up to which sampling counts as even."""
RESOLVED = 0.1
"""Noise in spacings from which on neighbours tell where the surface is."""
NEIGHBOURS = 24
PLANE = 16
"""Neighbours of the plane through a point."""
ON_PLANE = 2.4
"""Distance in standard deviations of the noise, from which on a point is off the plane of a neighbour."""
FEW_PLANES = 6
"""Planes of neighbours that a stray point lies on at most."""
ALONE = 1.2
"""Distance of the nearest neighbour of a stray point, in spacings."""
LINK = 2.5
"""Distance up to which neighbours belong together, in spacings."""
SMALLEST, LARGEST = 8, 200
"""Points of a cluster of floaters."""
CLEAR = 5.0
"""Distance of a cluster from anything larger, in spacings."""
ROUND = 0.1
"""Second over first variance of a cluster that is no piece of a wire or scan line."""


def floaters(points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Find points that hover beside a surface.

    Parameters
    ----------
    points : ndarray, (N, 3) float64
        Distinct.

    Returns
    -------
    ndarray, (N,) bool
        All False where the sampling is uneven or too coarse to tell.
    """
    none = np.zeros(len(points), bool)
    if len(points) < FEWEST:
        return none
    middle, size = points.mean(0), float(np.ptp(points, axis=0).max())
    tree = cKDTree(points)
    scale = estimate_local_scale(points, tree, spatial_order((points - middle) / size))
    dense, sparse = np.quantile(scale.spacing, (0.1, 0.9))
    if sparse > EVEN * dense or np.median(scale.ratio) < RESOLVED:
        return none
    distance, index = tree.query(points, NEIGHBOURS + 1, workers=-1)
    distance, index = distance[:, 1:], index[:, 1:]
    stray = _stray(points, scale, distance[:, 0], index)
    return np.asarray(stray | _clusters(points, scale.spacing, distance, index))


def _stray(
    points: NDArray[np.float64], scale: LocalScale, nearest: NDArray[np.float64], index: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Which points are alone and lie on few of the planes through their neighbours ``index`` (N, K)."""
    alone = np.flatnonzero(nearest > ALONE * scale.spacing)
    stray = np.zeros(len(points), bool)
    if not len(alone):
        return stray
    around = index[alone]
    rows, at = np.unique(around, return_inverse=True)
    patch = points[np.column_stack([rows, index[rows, :PLANE]])]
    centre = patch.mean(1)
    patch = patch - centre[:, None]
    normal = np.linalg.eigh(patch.transpose(0, 2, 1) @ patch)[1][:, :, 0]
    at = at.reshape(around.shape)
    off = np.abs(((points[alone, None] - centre[at]) * normal[at]).sum(2))
    stray[alone] = (off <= ON_PLANE * scale.noise[alone, None]).sum(1) <= FEW_PLANES
    return stray


def _clusters(
    points: NDArray[np.float64],
    spacing: NDArray[np.float64],
    distance: NDArray[np.float64],
    index: NDArray[np.int64],
) -> NDArray[np.bool_]:
    """Which points belong to round clusters of a few points, far from everything larger."""
    found = np.zeros(len(points), bool)
    row, column = np.nonzero(distance < LINK * np.maximum(spacing[:, None], spacing[index]))
    graph = coo_matrix((np.ones(len(row), np.int8), (row, index[row, column])), (len(points),) * 2)
    _, label = connected_components(graph, directed=False)
    count = np.bincount(label)
    large = np.flatnonzero(count[label] > LARGEST)
    small = np.flatnonzero((count >= SMALLEST) & (count <= LARGEST))
    if not len(large) or not len(small):
        return found
    others, order, start = cKDTree(points[large]), np.argsort(label, kind="stable"), np.append(0, np.cumsum(count))
    for each in small:
        rows = order[start[each] : start[each + 1]]
        variance = np.linalg.eigvalsh(np.cov(points[rows].T))
        if variance[1] >= ROUND * variance[2]:
            apart, nearest = others.query(points[rows])
            found[rows] = np.median(apart / spacing[large[nearest]]) > CLEAR
    return found
