"""Initial normals: the caller's, or by principal component analysis of the nearest neighbours or of a ball."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from .ball_grid import CHOICE, BallGrids
from .frames import principal_axes

CHUNK = 16384
"""Points whose neighbour lists are held at once: bounds the memory at CHUNK x k x 16 bytes."""
NEAREST = 24
"""Neighbours of a normal whose scale nothing else decides."""
FEW = 8
"""Points that a ball must hold to have a normal of its own; fewer hardly span a plane."""


def pca_normals(
    points: NDArray[np.floating],
    k: int = NEAREST,
    *,
    tree: cKDTree | None = None,
    workers: int = -1,
    check: Callable[[], None] | None = None,
) -> NDArray[np.float32]:
    """Estimate normals as the direction of least variance among the k nearest neighbours.

    Parameters
    ----------
    points : ndarray, (N, 3) float
    k : int
        Neighbours, the point itself among them; at most N are used.
    tree : cKDTree, optional
        Of these points, where the caller has one already.
    workers : int
        Threads of the neighbour search; -1 takes all.
    check : callable, optional
        Called between chunks; may raise to stop.

    Returns
    -------
    ndarray, (N, 3) float32
        Unit normals without a consistent sign.
    """
    located: NDArray[np.float64] = np.ascontiguousarray(points, np.float64)
    tree = cKDTree(located) if tree is None else tree
    k = min(k, len(located))
    normals = np.empty(located.shape, np.float32)
    for own in _chunks(tree.indices, check):
        normals[own] = _nearest_normals(located, own, k, tree, workers=workers)
    return normals


def ball_normals(
    points: NDArray[np.float64],
    radius: float | NDArray[np.float64],
    *,
    most: int = 64,
    tree: cKDTree | None = None,
    check: Callable[[], None] | None = None,
) -> NDArray[np.float32]:
    """PCA normals of a random subset of each point's ball: of adaptive scale where the radius follows the noise.

    Parameters
    ----------
    points : ndarray, (N, 3) float64
    radius : float or ndarray, (N,) float64
        Of the balls, in the unit of the points.
    most : int
        Points a ball, at most.
    tree : cKDTree, optional
        Of these points, where the caller has one already.
    check : callable, optional
        See :func:`pca_normals`.

    Returns
    -------
    ndarray, (N, 3) float32
        Unit normals without a consistent sign; of the nearest neighbours where a ball holds fewer than ``FEW``.
    """
    grids = BallGrids(points, np.broadcast_to(np.asarray(radius, np.float64), len(points)), crowd=CHOICE * most)
    tree = cKDTree(points) if tree is None else tree
    normals = np.empty(points.shape, np.float32)
    for own in _chunks(tree.indices, check):  # neighbours follow one another there: they are in the caches
        index = np.concatenate([own[:, None], grids.subset(own, most - 1, seed=0)], 1)
        normals[own] = principal_axes(points, index)[:, 2]
        lonely = own[(index >= 0).sum(1) < FEW]
        if len(lonely):
            normals[lonely] = _nearest_normals(points, lonely, min(NEAREST, len(points)), tree, workers=1)
    return normals


def _nearest_normals(
    points: NDArray[np.float64], rows: NDArray[np.int64], k: int, tree: cKDTree, *, workers: int
) -> NDArray[np.float64]:
    _, index = tree.query(points[rows], k, workers=workers)
    return principal_axes(points, np.asarray(index, np.int64).reshape(-1, k))[:, 2]


def _chunks(order: NDArray[np.int64], check: Callable[[], None] | None) -> Iterator[NDArray[np.int64]]:
    for start in range(0, len(order), CHUNK):
        if check is not None:
            check()
        yield order[start : start + CHUNK]


def raw_normals(
    points: NDArray[np.float64],
    given: NDArray[np.floating] | None,
    *,
    tree: cKDTree,
    reach: float | NDArray[np.float64] = 0.0,
    replace: bool = False,
    check: Callable[[], None] | None = None,
) -> NDArray[np.float32]:
    """Return the given normals at unit length, and estimated ones for rows without.

    Parameters
    ----------
    points : ndarray, (N, 3) float64
    given : ndarray, (N, 3) float, optional
        Of any length; a row that is zero or not finite counts as missing.
    tree : cKDTree
        Of the points.
    reach : float or ndarray, (N,) float64
        Radius of the balls of estimated normals; 0 for the 24 nearest neighbours.
    replace : bool
        Of the given normals keep the side alone.
    check : callable, optional
        See :func:`pca_normals`.

    Returns
    -------
    ndarray, (N, 3) float32
    """

    def estimated() -> NDArray[np.float32]:
        if np.any(reach):
            return ball_normals(points, reach, tree=tree, check=check)
        return pca_normals(points, tree=tree, check=check)

    if given is None:
        return estimated()
    normals = np.asarray(given, np.float64)
    length = np.linalg.norm(normals, axis=1)
    usable = np.isfinite(length) & (length > 0)
    unit: NDArray[np.floating] = np.where(usable[:, None], normals, 0) / np.where(usable, length, 1)[:, None]
    if replace:
        unit = unit_towards(estimated(), unit)
    elif not usable.all():
        unit = np.where(usable[:, None], unit, estimated())
    return np.asarray(unit, np.float32)


def unit_towards(normals: NDArray[np.floating], like: NDArray[np.floating]) -> NDArray[np.floating]:
    """Scale normals (N, 3) to unit length and turn them to the side of ``like`` (N, 3)."""
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    return np.where((normals * like).sum(1, keepdims=True) < 0, -normals, normals)
