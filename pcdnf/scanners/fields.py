"""Smooth random fields in space: correlated noise, texture, relief."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from .scene import Floats

WAVES = 160
"""Random waves in a field: enough that its values are near to normally distributed."""
_AT_ONCE = 4096


class SmoothField:
    """A stationary Gaussian field of mean 0 and variance 1 as a sum of random waves (Rahimi and Recht 2007).

    Parameters
    ----------
    rng : Generator
    length : float
        Correlation length: at this distance the correlation has fallen to exp(-1/2).
    dimensions : int
        Of the space.
    """

    def __init__(self, rng: Generator, length: float, dimensions: int = 3) -> None:
        self._waves = rng.normal(size=(dimensions, WAVES)) / length
        self._phases = rng.uniform(0, 2 * np.pi, WAVES)

    def __call__(self, at: Floats) -> Floats:
        """Values (N,) at points (N, dimensions)."""
        parts = [
            np.cos(at[start : start + _AT_ONCE] @ self._waves + self._phases).sum(1)
            for start in range(0, len(at), _AT_ONCE)
        ]
        return np.asarray(np.sqrt(2 / WAVES) * np.concatenate(parts)) if parts else np.zeros(0)
