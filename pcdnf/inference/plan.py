"""What a run will do: how many iterations, with which patch radius. Chosen from noise and spacing, or by the caller."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..geometry.noise import Scale, estimate_scale
from ..geometry.recipe import Recipe
from .options import check_iterations, check_radius
from .unit_frame import Frame

CLEAN, HEAVY = 0.1, 6.0
"""Noise in spacings below which one iteration is enough, and above which a third one gains."""
USUAL, SMALL = 200, 0.04
"""Points that a ball shall hold even where the noise seems slight, while it stays below this share of the diagonal: the
steps of a depth camera look like clean surface to a smaller one."""

LARGEST = 0.07
"""Share of the diagonal beyond which the radius grows no more with the noise: features of the shape are that size."""


@dataclass(frozen=True)
class Plan:
    """Of one run on one cloud.

    Attributes
    ----------
    scale : Scale
        Estimated noise and spacing, in the cloud's unit.
    radii : tuple of float
        Patch radius of each iteration, in the cloud's unit.
    neighbours : int, optional
        Of each point, the point among them; the recipe's where None. See :func:`pcdnf.inference.options.check_fast`.
    """

    scale: Scale
    radii: tuple[float, ...]
    neighbours: int | None = None

    @property
    def iterations(self) -> int:
        """How many there are."""
        return len(self.radii)

    def to_json(self) -> dict[str, Any]:
        """Plain values that lose nothing."""
        values = {"noise": self.scale.noise, "spacing": self.scale.spacing, "radii": list(self.radii)}
        return values if self.neighbours is None else values | {"neighbours": self.neighbours}

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Plan:
        """The inverse of :meth:`to_json`."""
        return cls(Scale(values["noise"], values["spacing"]), tuple(values["radii"]), values.get("neighbours"))

    def metadata(self) -> dict[str, str]:
        """For the result's file: noise, spacing and radii in the cloud's unit, iterations; of a fast run, how fast."""
        fast = {} if self.neighbours is None else {"fast": f"{self.neighbours} neighbours"}
        return fast | {
            "iterations": str(self.iterations),
            "radius": ", ".join(f"{radius:.6g}" for radius in self.radii),
            "estimated_noise": f"{self.scale.noise:.4g}",
            "estimated_spacing": f"{self.scale.spacing:.4g}",
        }


def make_plan(
    points: NDArray[np.float64],
    recipe: Recipe,
    *,
    frame: Frame,
    iterations: int | str = "auto",
    radius: float | str = "auto",
    neighbours: int | None = None,
) -> Plan:
    """Plan a run.

    Parameters
    ----------
    points : ndarray, (N, 3) float64
        World coordinates.
    recipe : Recipe
        Of the network's patches.
    frame : Frame
        Of the points.
    iterations : int or "auto"
        "auto" takes one for a nearly clean cloud, two as a rule, three where the noise is many spacings deep.
    radius : float, str or "auto"
        A length in the cloud's unit, a share of its diagonal such as "4%", or "auto": by noise and spacing.
    neighbours : int, optional
        As in :class:`Plan`.

    Raises
    ------
    ChoiceError
        See :mod:`pcdnf.inference.options`.
    """
    count, length = check_iterations(iterations), check_radius(radius)
    local = frame.to_local(points)
    scale = estimate_scale(local, cKDTree(local)).rounded()
    if count is None:
        ratio = scale.noise / max(scale.spacing, 1e-12)
        count = 1 if ratio < CLEAN else 2 if ratio < HEAVY else 3
    if length is None:
        first = recipe.radius
        if recipe.adaptive:
            usual = min(scale.spacing * math.sqrt(USUAL / math.pi), SMALL)
            first = max(min(recipe.adaptive_radius(scale), LARGEST), recipe.least_radius(scale), usual)
        first = first or recipe.radius  # where most points are copies of one another
        radii = (first, *[first * recipe.later] * (count - 1))
    else:
        value, relative = length
        radii = (value if relative else value / frame.diagonal,) * count
    unit = frame.diagonal
    return Plan(scale.scaled(unit), tuple(value * unit for value in radii), neighbours)


def iteration_seed(seed: int, iteration: int) -> int:
    """Seed of one iteration's random subsets."""
    return seed + iteration
