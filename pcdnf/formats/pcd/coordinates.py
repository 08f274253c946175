"""Coordinates of a PCD: as float32, which PCL, Open3D and CloudCompare read, with remainders where these matter.

PCL's filters take coordinates of 8 bytes for an empty cloud, and Open3D reads zeros.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..limits import bounds, finite_rows

REMAINDERS = ("x_rest", "y_rest", "z_rest")
"""Fields of what float32 leaves of each coordinate: ``x + x_rest``, added as float64, is the coordinate."""

FINE = 1000
"""Steps of float32 between two neighbouring points, at least; with fewer, remainders are stored."""

TINY, HUGE = 1e-30, 1e30
"""Coordinates beyond which float32 holds no remainders."""

Columns = dict[str, NDArray[Any]]


def split(points: NDArray[Any], names: tuple[str, str, str]) -> Columns:
    """Coordinates (N, 3) as float32 columns and their remainders."""
    near = points.astype(np.float32)
    rest = (points - near).astype(np.float32)
    return {name: near[:, axis] for axis, name in enumerate(names)} | {
        name: rest[:, axis] for axis, name in enumerate(REMAINDERS)
    }


def joined(near: NDArray[Any], rest: NDArray[Any]) -> NDArray[np.float64]:
    """Return the inverse of :func:`split`, (N, 3) each."""
    points: NDArray[np.float64] = near.astype(np.float64) + np.where(np.isfinite(rest), rest, 0)
    return points


def for_most_readers(points: NDArray[Any], names: tuple[str, str, str]) -> tuple[Columns, list[str]]:
    """Return the fields to store float64 coordinates in, and a note on them."""
    finite = finite_rows(points)
    most = float(np.abs(points[finite]).max(initial=0))
    if not TINY < most < HUGE:
        return {name: points[:, axis] for axis, name in enumerate(names)}, []
    near = points.astype(np.float32)
    plain: Columns = {name: near[:, axis] for axis, name in enumerate(names)}
    if np.array_equal(near[finite], points[finite]):
        return plain, []
    low, high = bounds(points[finite])
    step = float(np.spacing(np.float32(most)))
    spacing = float(np.linalg.norm(high - low)) / math.sqrt(int(finite.sum()))
    if step * FINE <= spacing:
        return plain, [f"PCD got coordinates as float32, in steps of at most {step:.2g}, since PCL reads no doubles."]
    return split(points, names), [
        f"PCD got coordinates as float32, since PCL and Open3D read no doubles: in steps of {step:.2g} here. What that "
        f"leaves is in the fields {', '.join(REMAINDERS)}. Ask for coordinates float32 to have them moved to the "
        "origin, or float64 to have doubles."
    ]
