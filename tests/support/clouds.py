"""Clouds that tests of several modules use."""

from __future__ import annotations

import numpy as np


def noisy_sphere(count: int, noise: float) -> np.ndarray:
    """A unit sphere (count, 3) float64 with Gaussian noise of this standard deviation a coordinate."""
    rng = np.random.default_rng(0)
    points = rng.normal(size=(count, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True) + noise * rng.normal(size=(count, 3))
