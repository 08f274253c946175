"""Consistent sides for normals: propagation over tangent planes (Hoppe et al., SIGGRAPH 1992)."""

from __future__ import annotations

import numba as nb
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree
from scipy.spatial import cKDTree

NEIGHBOURS = 10
"""Of each point, along which a side is passed on."""


def orient_normals(
    points: NDArray[np.floating],
    normals: NDArray[np.floating],
    *,
    like: NDArray[np.floating] | None = None,
    neighbours: int = NEIGHBOURS,
) -> NDArray[np.floating]:
    """Turn normals to one side of each connected piece of the surface.

    A minimum spanning tree joins neighbours with parallel normals first, and the side is propagated along it.
    Each piece then faces outwards (its outermost point away from the centre of the piece), or agrees with the majority
    of ``like``.

    Parameters
    ----------
    points : ndarray, (N, 3) float
    normals : ndarray, (N, 3) float
        Unit length.
    like : ndarray, (N, 3) float, optional
        Normals whose side the majority of the result takes; rows that are not finite are ignored.
    neighbours : int
        Of each point.

    Returns
    -------
    ndarray, (N, 3)
        The normals, some of them reversed, in their type.
    """
    located: NDArray[np.float64] = np.ascontiguousarray(points, np.float64)
    count = min(neighbours + 1, len(located))
    _, index = cKDTree(located).query(located, count, workers=-1)
    rows = np.repeat(np.arange(len(located)), count - 1)
    columns = index[:, 1:].ravel()
    cosine = np.abs((normals[rows] * normals[columns]).sum(1))
    graph = coo_array((1 + 1e-6 - np.minimum(cosine, 1), (rows, columns)), shape=(len(located),) * 2).tocsr()
    tree = minimum_spanning_tree(graph).tocoo()
    pieces, labels = connected_components(tree, directed=False)
    sizes = np.bincount(labels, minlength=pieces)
    middle = np.stack([np.bincount(labels, axis, pieces) for axis in located.T], 1) / sizes[:, None]
    outward = located - middle[labels]
    roots = _outermost(outward, labels, pieces)
    # One more node, joined to the root of every piece, makes one tree of them all.
    extra = np.full(pieces, len(located))
    links = (np.concatenate([tree.row, extra]), np.concatenate([tree.col, roots]))
    joined = coo_array((np.ones(len(links[0])), links), shape=(len(located) + 1,) * 2).tocsr()
    order, parent = breadth_first_order(joined, len(located), directed=False)
    directions = np.asarray(normals, np.float64)
    side = _passed_on(order, parent, directions)
    if like is None:
        vote = (directions[roots] * outward[roots]).sum(1) * side[roots]
    else:
        known = np.where(np.isfinite(like).all(1, keepdims=True), like, 0)
        vote = np.bincount(labels, (directions * side[:, None] * known).sum(1), pieces)
    side *= np.where(vote < 0, -1.0, 1.0)[labels]
    return np.asarray(normals * side[:, None], normals.dtype)


def _outermost(outward: NDArray[np.float64], labels: NDArray[np.integer], pieces: int) -> NDArray[np.int64]:
    """Row of each piece's point farthest from its middle."""
    order = np.lexsort((-(outward**2).sum(1), labels))
    first = np.searchsorted(labels[order], np.arange(pieces))
    return np.asarray(order[first], np.int64)


@nb.njit(cache=True)
def _passed_on(order, parent, normals):  # type: ignore[no-untyped-def]
    side = np.ones(len(normals))
    for i in order[1:]:
        j = parent[i]
        if j < len(normals):
            cosine = 0.0
            for axis in range(3):
                cosine += normals[i, axis] * normals[j, axis]
            side[i] = side[j] if cosine >= 0 else -side[j]
    return side
