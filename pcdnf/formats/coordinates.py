"""Coordinates as float32 or float64, and steps of float32 that are coarser than what is measured."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np

from .flavours import PcdFlavour
from .limits import Array, bounds
from .point_cloud import PointCloud

Coordinates = Literal["keep", "float32", "float64"]

STEPS = 20
"""Steps of float32 between two neighbouring points, at least, for coordinates to count as exact."""
STEPS_OF_NOISE = 1000
"""The same where the steps exceed the noise; finer ones do no harm, however smooth a cloud is."""
_FAR = 10_000
"""Distance from the origin from which on coordinates are moved before they become float32."""
_ROUND = 1000


def spacing(points: Array) -> float:
    """Return the typical distance of neighbours on a surface of finite points (N, 3), from diagonal and count."""
    low, high = bounds(points)
    return math.hypot(*(high - low).tolist()) / math.sqrt(len(points))


def without_steps(cloud: PointCloud, noise: float = math.inf) -> PointCloud:
    """Return the cloud with float64 coordinates and a warning if the steps of its float32 ones are too coarse.

    Parameters
    ----------
    cloud : PointCloud
    noise : float, optional
        Standard deviation of the points from the surface, where it is known: steps shall not exceed it.
    """
    if cloud.points.dtype != np.float32:
        return cloud
    step = float(np.spacing(np.abs(cloud.points).max()))
    usual = spacing(cloud.points)
    if step * STEPS <= usual and (step <= noise or step * STEPS_OF_NOISE <= usual):
        return cloud
    holes = cloud.holes
    return replace(
        cloud,
        points=cloud.points.astype(np.float64),
        holes=None if holes is None else replace(holes, points=holes.points.astype(np.float64)),
        warnings=[
            *cloud.warnings,
            f"The coordinates are float32 far from the origin: they come in steps of {step:.2g}, which is coarse for "
            "this cloud. Export it as float64, or moved to the origin. The result is stored as float64.",
        ],
    )


def with_coordinates(cloud: PointCloud, kind: Coordinates) -> tuple[PointCloud, list[str]]:
    """Return the cloud with coordinates of a type, and a sentence on what that changed.

    Parameters
    ----------
    cloud : PointCloud
    kind : {"keep", "float32", "float64"}
        With float32, coordinates far from the origin are moved by a round offset, which is recorded in the metadata.
    """
    if kind == "keep":
        return cloud, []
    if kind == "float64":
        typed = _typed(cloud, np.float64, np.zeros(3))
        flavour = typed.flavour
        return replace(typed, flavour=flavour.with_doubles() if isinstance(flavour, PcdFlavour) else flavour), []
    low, high = bounds(cloud.points)
    middle = (low + high) / 2
    offset = np.where(np.abs(middle) > _FAR, np.round(middle / _ROUND) * _ROUND, 0.0)
    moved = _typed(cloud, np.float32, offset)
    if not offset.any():
        return moved, []
    text = " ".join(f"{value:.0f}" for value in offset)
    moved.metadata["offset"] = text
    return moved, [f"Coordinates are float32 and were moved: add {text} to get those of the input."]


def _typed(cloud: PointCloud, kind: type[np.floating], offset: Array) -> PointCloud:
    holes = cloud.holes
    return replace(
        cloud,
        points=(cloud.points - offset).astype(kind),
        holes=None if holes is None else replace(holes, points=(holes.points - offset).astype(kind)),
        metadata=dict(cloud.metadata),
    )
