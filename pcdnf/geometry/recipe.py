"""Patch recipes: how the patches of a network are taken."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any, Literal

from .noise import NoiseEstimate


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """How patches are taken. Part of a checkpoint's metadata, never the caller's choice.

    Attributes
    ----------
    kind : {"ball", "knn", "near-far"}
    points : int
        M, points a patch.
    radius : float
        r, as a fraction of the cloud's bounding-box diagonal.
    near : int
        Nearest neighbours of ``near-far``, the centre among them.
    upward : bool
        Raw normals are flipped to z >= 0 in the patch frame.
    fewest : int
        Points a typical ball must hold: a sparser cloud gets a larger radius, rather than patches of padding.
    adaptive : float
        Where positive, the radius is this many times the geometric mean of noise and spacing, instead of r.
    later : float
        Radius of later iterations relative to the first one's.
    normals : {"pca", "ball"}
        Where raw normals come from, as trained: :func:`pcdnf.geometry.normals.pca_normals`, or ``ball_normals`` of
        a radius that suits the noise.
    """

    kind: Literal["ball", "knn", "near-far"] = "ball"
    points: int = 512
    radius: float = 0.05
    near: int = 0
    upward: bool = True
    fewest: int = 0
    adaptive: float = 0.0
    later: float = 1.0
    normals: Literal["pca", "ball"] = "pca"

    def adaptive_radius(self, scale: NoiseEstimate) -> float:
        """Return the first pass's radius for a cloud, in its unit, at least :meth:`least_radius`."""
        return max(self.adaptive * math.sqrt(scale.noise * scale.spacing), self.least_radius(scale))

    @property
    def local(self) -> bool:
        """Whether the radius may differ from point to point."""
        return self.adaptive > 0 and self.kind == "ball"

    def least_radius(self, scale: NoiseEstimate) -> float:
        """Of a flat ball that holds ``fewest`` points, in the cloud's unit."""
        return scale.spacing * math.sqrt(max(self.fewest, 1) / math.pi)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for a checkpoint's metadata."""
        return asdict(self)
