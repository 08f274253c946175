"""Patches whose radius differs from point to point, of points that lie on the centre's own sheet of surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .ball_grid import CHOICE, BallGrids
from .frames import local_patches
from .patches import Patches
from .recipe import Recipe
from .sheets import without_other_sheets


class LocalPatchSource:
    """Takes patches of kind "ball" from one cloud.

    Parameters
    ----------
    points : ndarray, (N, 3) float64
    normals : ndarray, (N, 3) float32
        Raw normals, of unit length.
    recipe : Recipe
        Of kind "ball"; its radius is not used.
    radius : ndarray, (N,) float64
        Patch radius of each point, in the unit of the points.
    noise : ndarray, (N,) float64
        Noise around each point, in that unit.
    seed : int
        Of the random subsets.
    sided : bool
        Whether the normals' signs tell the sides of a wall apart.
    """

    def __init__(
        self,
        points: NDArray[np.float64],
        normals: NDArray[np.float32],
        recipe: Recipe,
        *,
        radius: NDArray[np.float64],
        noise: NDArray[np.float64],
        seed: int,
        sided: bool = False,
    ) -> None:
        self.points, self.normals, self.recipe = points, normals, recipe
        self.radius, self.noise, self.seed, self.sided = radius, noise, seed, sided
        self.grids = BallGrids(points, radius, crowd=CHOICE * recipe.points)

    def take(self, centres: NDArray[np.int64]) -> Patches:
        """Patches of the points ``centres`` (B,), in their frames."""
        drawn = self.grids.subset(centres, self.recipe.points - 1, seed=self.seed)
        index = np.concatenate([centres[:, None], drawn], 1)
        index = without_other_sheets(self.points, self.normals, index, self.noise, sided=self.sided)
        points, normals, frames = local_patches(
            self.points, self.normals, index, self.radius[centres], upward=self.recipe.upward
        )
        return Patches(points, normals, frames, index)

    def radii(self, centres: NDArray[np.int64]) -> NDArray[np.float64]:
        """Patch radius of the points ``centres`` (B,)."""
        return self.radius[centres]
