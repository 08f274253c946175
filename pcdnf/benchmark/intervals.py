"""Confidence intervals of the difference between two methods: a bootstrap of paired differences.

Errors of neighbouring points are correlated. The bootstrap therefore draws cells of the clean cloud's grid, each with
all its points; drawing single points would make the interval several times too narrow.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

CELL = 0.05
"""Side of a cell in bounding-box diagonals of the clean cloud, about a patch's radius."""
DRAWS = 2000


@dataclass(frozen=True)
class Interval:
    """A mean difference and the 95 % interval of it."""

    mean: float
    low: float
    high: float


def paired_interval(first: Floats, second: Floats, places: Floats, *, seed: int = 0) -> Interval:
    """Mean of ``first - second`` with its 95 % bootstrap interval over cells.

    Parameters
    ----------
    first, second : (N,) arrays
        Errors of the same points by two methods.
    places : (N, 3) array
        Their clean points, which say what cell they are in.
    seed : int
    """
    difference = np.asarray(first, np.float64) - second
    low = places.min(axis=0)
    side = CELL * float(np.linalg.norm(places.max(axis=0) - low))
    _, cell = np.unique(np.floor((places - low) / side).astype(np.int64), axis=0, return_inverse=True)
    count = np.bincount(cell.ravel()).astype(np.float64)
    total = np.bincount(cell.ravel(), difference)
    rng = np.random.default_rng(seed)
    drawn = rng.multinomial(len(count), np.full(len(count), 1 / len(count)), size=DRAWS)  # (DRAWS, cells)
    means = (drawn @ total) / (drawn @ count)
    bounds = np.percentile(means, [2.5, 97.5])
    return Interval(float(difference.mean()), float(bounds[0]), float(bounds[1]))
