"""Patches: which neighbours a network sees of each point, by the recipe its checkpoint was trained with.

``ball``      the centre and a random subset of the ball of radius r, M points (paper, section 3.2.1)
``knn``       the M nearest neighbours, still divided by r (the authors' release)
``near-far``  the nearest neighbours inside the ball and a random subset of the rest of it (the light network)

Padding (fewer neighbours than M) is the centre itself, the origin of the patch frame. Neighbours depend on
(cloud, seed, index of the centre) alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from .ball_grid import CHOICE, BallGrid
from .frames import local_patches
from .recipe import Recipe


@dataclass(frozen=True)
class Patches:
    """A batch of patches in their own frames; see :func:`pcdnf.geometry.frames.local_patches`.

    Attributes
    ----------
    points, normals : ndarray, (B, M, 3) float32
    frames : ndarray, (B, 3, 3) float32
    index : ndarray, (B, M) int64
        Neighbours, the centre first, -1 for padding.
    """

    points: NDArray[np.float32]
    normals: NDArray[np.float32]
    frames: NDArray[np.float32]
    index: NDArray[np.int64]


class PatchSource:
    """Takes patches from one cloud.

    Parameters
    ----------
    points : ndarray, (N, 3) float64
    normals : ndarray, (N, 3) float32
        Raw normals.
    recipe : Recipe
    diagonal : float
        Bounding-box diagonal the recipe's radius refers to, in the unit of the points.
    seed : int
        Of the random subsets.
    tree : cKDTree, optional
        Of these points, where the caller has one already.
    workers : int
        Threads of the neighbour search; -1 takes all.
    """

    def __init__(
        self,
        points: NDArray[np.float64],
        normals: NDArray[np.float32],
        recipe: Recipe,
        *,
        diagonal: float,
        seed: int,
        tree: cKDTree | None = None,
        workers: int = -1,
    ) -> None:
        self.points, self.normals, self.recipe = points, normals, recipe
        self.seed, self._workers = seed, workers
        tree = cKDTree(points) if tree is None else tree
        self.radius = max(recipe.radius * diagonal, _reach(tree, recipe.fewest))
        self._tree = tree if recipe.kind != "ball" else None
        self.grid = BallGrid(points, self.radius, crowd=CHOICE * recipe.points) if recipe.kind != "knn" else None

    def neighbours(self, centres: NDArray[np.int64], *, seed: int | None = None) -> NDArray[np.int64]:
        """Neighbours (B, M) int64 of the points ``centres`` (B,), the centre first, -1 for padding.

        ``seed`` replaces the source's own, for training that wants a fresh subset each time.
        """
        recipe, seed = self.recipe, self.seed if seed is None else seed
        at = self.points[centres]
        own = centres[:, None]
        if self._tree is None:
            assert self.grid is not None
            return np.concatenate([own, self.grid.subset(at, centres, recipe.points - 1, seed=seed)], 1)
        near = recipe.points if self.grid is None else recipe.near
        reach = np.inf if self.grid is None else self.radius
        distance, index = self._tree.query(at, near, distance_upper_bound=reach, workers=self._workers)
        index = np.where(index < len(self.points), index, -1)
        index = _centre_first(index, centres)
        if self.grid is None:
            return index
        inner = np.where(np.isfinite(distance[:, -1]), distance[:, -1] * (1 + 1e-9), self.radius)
        far = self.grid.subset(at, centres, recipe.points - near, seed=seed, inner=inner)
        return np.concatenate([index, far], 1)

    def take(
        self,
        centres: NDArray[np.int64],
        *,
        seed: int | None = None,
        spin: NDArray[np.float64] | None = None,
    ) -> Patches:
        """Patches of the points ``centres`` (B,), in their frames."""
        index = self.neighbours(centres, seed=seed)
        points, normals, frames = local_patches(
            self.points, self.normals, index, self.radius, upward=self.recipe.upward, spin=spin
        )
        return Patches(points, normals, frames, index)

    def radii(self, centres: NDArray[np.int64]) -> NDArray[np.float64]:
        """Patch radius of the points ``centres`` (B,)."""
        return np.full(len(centres), self.radius)


def _reach(tree: cKDTree, count: int) -> float:
    """Radius within which a typical point has ``count`` points, itself among them; 0 for none."""
    count = min(count, tree.n)
    if count == 0:
        return 0.0
    sample = np.linspace(0, tree.n - 1, min(tree.n, 512)).astype(np.int64)
    distance, _ = tree.query(tree.data[sample], [count])
    return float(np.median(distance))


def _centre_first(index: NDArray[np.int64], centres: NDArray[np.int64]) -> NDArray[np.int64]:
    """Put each centre in the first column; a duplicate of it may have been listed before, or in its place."""
    at = np.where(index == centres[:, None], 1, 0).argmax(1)  # 0 also where it is not listed
    rows = np.arange(len(index))
    index[rows, at] = index[:, 0]
    index[:, 0] = centres
    return index
