"""Limits of a reader, and the checks against them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from .errors import FormatError

Array = NDArray[Any]
NonFinite = Literal["keep", "reject", "drop"]
NON_FINITE: tuple[NonFinite, ...] = get_args(NonFinite)

FLOATS = (np.dtype(np.float32), np.dtype(np.float64))
"""Types of coordinates and normals in memory."""


EXTENT_RANGE = (1e-12, 1e12)
"""Bounding-box diagonals that are accepted: inside it, squares and quotients stay finite in float64."""


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What a reader accepts.

    Attributes
    ----------
    max_points : int
        Most points of a cloud.
    max_bytes : int
        Most bytes of the file, and of what an NPZ inflates to.
    minimum_points : int
        Fewest finite points.
    nonfinite : {"keep", "reject", "drop"}
        What happens to rows with NaN or infinity in their coordinates: they are put aside and come back in their
        places, the file is refused, or they are left out.
    """

    max_points: int = 100_000_000
    max_bytes: int = 8 * 1024**3
    minimum_points: int = 1
    nonfinite: NonFinite = "keep"

    def __post_init__(self) -> None:
        if self.nonfinite not in NON_FINITE:
            raise ValueError(f"nonfinite must be one of {', '.join(NON_FINITE)}, not {self.nonfinite!r}")
        if min(self.max_points, self.max_bytes, self.minimum_points) < 1:
            raise ValueError("max_points, max_bytes and minimum_points must be at least 1")


def check_enough(count: int, limits: Limits) -> None:
    """Raise ``too_few_points`` when ``count`` is under the minimum."""
    if count < limits.minimum_points:
        raise FormatError(
            f"The cloud has {count} points; at least {limits.minimum_points} are needed.",
            code="too_few_points",
            hint="Send a denser or a larger cloud.",
            limit=limits.minimum_points,
            actual=count,
        )


def check_count(count: int, limits: Limits) -> None:
    """Raise ``too_many_points`` when ``count`` is over the limit."""
    if count > limits.max_points:
        raise FormatError(
            f"The file declares {count} points; the limit is {limits.max_points}.",
            code="too_many_points",
            hint="Cut the cloud into parts, or thin it out.",
            limit=limits.max_points,
            actual=count,
        )


def check_extent(points: Array) -> None:
    """Raise ``zero_extent`` or ``extent_out_of_range`` by the bounding-box diagonal of finite points."""
    with np.errstate(over="ignore"):
        low, high = bounds(points)
        spans = high - low
    diagonal = math.hypot(*spans.tolist())
    if diagonal == 0:
        raise FormatError(
            f"All {len(points)} points are equal, so the cloud has no surface.",
            code="zero_extent",
            hint="Check that the coordinates were exported.",
        )
    smallest, largest = EXTENT_RANGE
    if not smallest <= diagonal <= largest:
        raise FormatError(
            f"The bounding box has a diagonal of {diagonal:.3g}; it must lie between {smallest:g} and {largest:g}.",
            code="extent_out_of_range",
            hint="Remove outliers, or change the unit of the coordinates.",
        )


def bounds(points: Array) -> tuple[Array, Array]:
    """Return the lowest and the highest coordinates of points (N, 3), each (3,) float64.

    Column by column: numpy takes 20 times as long for ``points.max(axis=0)``.
    """
    columns = points.T
    low = np.array([column.min() for column in columns], np.float64)
    return low, np.array([column.max() for column in columns], np.float64)


def finite_rows(points: Array) -> Array:
    """Return which rows of (N, 3) have finite coordinates, (N,) bool."""
    finite = np.isfinite(points[:, 0])
    for axis in (1, 2):
        finite &= np.isfinite(points[:, axis])
    return finite
