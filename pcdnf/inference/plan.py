"""What a run will do: how many iterations, with which patch radius. Chosen from noise and spacing, or by the caller."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..geometry.local_scale import LocalScale
from ..geometry.noise import NoiseEstimate, estimate_noise
from ..geometry.recipe import Recipe
from .options import check_iterations, check_radius
from .unit_frame import UnitFrame

CLEAN, HEAVY = 0.1, 6.0
"""Noise in spacings below which one iteration is enough, and above which a third one gains."""
USUAL, SMALL = 200, 0.04
"""Points that a ball shall hold even where the noise seems slight, while it stays below this share of the diagonal: the
steps of a depth camera look like clean surface to a smaller one."""
RARE = 0.001
"""Share of the points for whose sake there is another iteration."""
DEEP = 9.0
"""Noise in spacings above which a third iteration gains, by local estimates, which are higher."""
LOCAL = 0.92
"""Radius relative to the recipe's for the same noise and spacing: the recipe was made with a lower estimate of both."""
LARGEST = 0.07
"""Share of the diagonal beyond which the radius grows no more with the noise: features of the shape are that size."""


@dataclass(frozen=True)
class Plan:
    """Of one run on one cloud.

    Attributes
    ----------
    scale : NoiseEstimate
        Estimated noise and spacing, in the cloud's unit.
    radii : tuple of float
        Patch radius of each iteration, in the cloud's unit.
    neighbours : int, optional
        Of each point, the point among them; the recipe's where None. See :func:`pcdnf.inference.options.check_fast`.
    local : bool
        Whether the radius follows noise and spacing around each point; ``scale`` and ``radii`` are typical then.
    """

    scale: NoiseEstimate
    radii: tuple[float, ...]
    neighbours: int | None = None
    local: bool = False

    @property
    def iterations(self) -> int:
        """How many there are."""
        return len(self.radii)

    def to_json(self) -> dict[str, Any]:
        """Plain values that lose nothing."""
        values: dict[str, Any] = {"noise": self.scale.noise, "spacing": self.scale.spacing, "radii": list(self.radii)}
        if self.local:
            values["local"] = True
        return values if self.neighbours is None else values | {"neighbours": self.neighbours}

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Plan:
        """Invert :meth:`to_json`."""
        scale = NoiseEstimate(values["noise"], values["spacing"])
        return cls(scale, tuple(values["radii"]), values.get("neighbours"), values.get("local", False))

    def metadata(self) -> dict[str, str]:
        """For the result's file: noise, spacing and radii in the cloud's unit, iterations; of a fast run, how fast."""
        fast = {} if self.neighbours is None else {"fast": f"{self.neighbours} neighbours"}
        return fast | {
            "iterations": str(self.iterations),
            "radius": ("about " if self.local else "") + ", ".join(f"{radius:.6g}" for radius in self.radii),
            "estimated_noise": f"{self.scale.noise:.4g}",
            "estimated_spacing": f"{self.scale.spacing:.4g}",
        }


def make_plan(
    points: NDArray[np.float64],
    recipe: Recipe,
    *,
    frame: UnitFrame,
    iterations: int | str = "auto",
    radius: float | str = "auto",
    neighbours: int | None = None,
    scale: LocalScale | None = None,
) -> Plan:
    """Plan a run.

    Parameters
    ----------
    points : ndarray, (N, 3) float64
        World coordinates.
    recipe : Recipe
        Of the network's patches.
    frame : UnitFrame
        Of the points.
    iterations : int or "auto"
        "auto" takes one for a nearly clean cloud, two as a rule, three where the noise is many spacings deep.
    radius : float, str or "auto"
        A length in the cloud's unit, a share of its diagonal such as "4%", or "auto": by noise and spacing.
    neighbours : int, optional
        As in :class:`Plan`.
    scale : LocalScale, optional
        Of the points, in the frame's unit: then a radius that is chosen here differs from point to point.

    Raises
    ------
    ChoiceError
        See :mod:`pcdnf.inference.options`.
    """
    count, length = check_iterations(iterations), check_radius(radius)
    if scale is not None and length is None:
        return _local_plan(scale, recipe, frame.diagonal, count, neighbours)
    local = frame.to_local(points)
    typical = estimate_noise(local, cKDTree(local)).rounded()
    if count is None:
        ratio = typical.noise / max(typical.spacing, 1e-12)
        count = 1 if ratio < CLEAN else 2 if ratio < HEAVY else 3
    if length is None:
        first = recipe.radius
        if recipe.adaptive:
            usual = min(typical.spacing * math.sqrt(USUAL / math.pi), SMALL)
            first = max(min(recipe.adaptive_radius(typical), LARGEST), recipe.least_radius(typical), usual)
        first = first or recipe.radius  # where most points are copies of one another
        radii = (first, *[first * recipe.later] * (count - 1))
    else:
        value, relative = length
        radii = (value if relative else value / frame.diagonal,) * count
    unit = frame.diagonal
    return Plan(typical.scaled(unit), tuple(value * unit for value in radii), neighbours)


def _local_plan(scale: LocalScale, recipe: Recipe, unit: float, count: int | None, neighbours: int | None) -> Plan:
    """Plan a run whose radius differs from point to point."""
    if count is None:
        share = [float((scale.ratio >= bound).mean()) for bound in (CLEAN, DEEP)]
        count = 1 if share[0] < RARE else 2 if share[1] < RARE else 3
    typical = scale.median().rounded()
    first = float(np.median(local_radius(scale, recipe)))
    radii = (first, *[first * recipe.later] * (count - 1))
    return Plan(typical.scaled(unit), tuple(value * unit for value in radii), neighbours, local=True)


def local_radius(scale: LocalScale, recipe: Recipe) -> NDArray[np.float64]:
    """Patch radius (N,) of the first iteration around each point, in the unit of the scale."""
    by_noise = LOCAL * recipe.adaptive * np.sqrt(scale.noise * scale.spacing) * scale.alike
    flat_ball = scale.spacing * math.sqrt(1 / math.pi)
    usual = np.minimum(flat_ball * math.sqrt(USUAL), SMALL * scale.extent)
    least = flat_ball * math.sqrt(max(recipe.fewest, 1))
    radius: NDArray[np.float64] = np.maximum.reduce([np.minimum(by_noise, LARGEST * scale.extent), usual, least])
    return np.maximum(radius, 1e-9)


def needs_pass(scale: LocalScale, iteration: int) -> NDArray[np.bool_]:
    """Points (N,) that an iteration denoises with the network: fewer and fewer, as the noise asks."""
    return np.asarray(scale.ratio >= (CLEAN if iteration < 2 else DEEP)) & ~scale.double


def iteration_seed(seed: int, iteration: int) -> int:
    """Seed of one iteration's random subsets."""
    return seed + iteration
