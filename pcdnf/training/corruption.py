"""The mix of clouds to train on: how many points, what noise, what is missing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

FEWEST_KEPT = 2000
"""Points that uneven sampling and holes leave; a cloud that would have fewer stays whole."""


@dataclass(frozen=True, kw_only=True)
class Corruption:
    """Shares of the clouds; the defaults are those the shipped weights were trained on.

    Attributes
    ----------
    points : tuple of int or None
        Range of the numbers of points, uniform in their logarithm; else 50 000 to 120 000, and some 6 000 to 200 000.
    thin : bool
        Solids of plates alone.
    laplace, uniform, anisotropic, scanner : float
        Shares with noise of that kind; the others' is Gaussian.
    outliers : float
        Share in which some points have two to six times the noise.
    uneven, holes : float
    """

    points: tuple[int, int] | None = None
    thin: bool = False
    laplace: float = 0.07
    uniform: float = 0.07
    anisotropic: float = 0.07
    scanner: float = 0.09
    outliers: float = 0.12
    uneven: float = 0.15
    holes: float = 0.15

    def count(self, rng: Generator) -> int:
        """Points of a cloud before any are taken away."""
        if self.points is not None:
            return int(np.exp(rng.uniform(*np.log(self.points))))
        return int(rng.uniform(50_000, 120_000) if rng.random() < 0.6 else np.exp(rng.uniform(*np.log([6e3, 2e5]))))

    def kept(self, rng: Generator, points: NDArray[np.float64]) -> NDArray[np.int64]:
        """Rows that a scan of uneven sampling, or with holes, would hold; most clouds stay whole."""
        keep = np.ones(len(points), bool)
        if rng.random() < self.uneven:  # density falls along a random direction
            position = points @ rng.normal(size=3)
            keep &= rng.random(len(points)) < np.clip((position - position.min()) / np.ptp(position), 0.15, 1)
        if rng.random() < self.holes:
            for middle in points[rng.integers(len(points), size=rng.integers(1, 12))]:
                keep &= ((points - middle) ** 2).sum(1) > rng.uniform(0.01, 0.06) ** 2
        rows = np.flatnonzero(keep)
        return rows if len(rows) > FEWEST_KEPT else np.arange(len(points))

    def noise(self, rng: Generator, clean: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
        """Noise (N, 3) of a random kind, and its level: standard deviation a coordinate, up to 3 % of the diagonal."""
        level = rng.uniform(0, 0.002) if rng.random() < 0.1 else np.exp(rng.uniform(*np.log([0.002, 0.03])))
        gaussian = 1 - self.laplace - self.uniform - self.anisotropic - self.scanner
        kind, shape = rng.random() - gaussian, clean.shape
        if kind < 0:
            noise = rng.normal(size=shape)
        elif kind < self.laplace:
            noise = rng.laplace(scale=np.sqrt(0.5), size=shape)
        elif kind < self.laplace + self.uniform:
            noise = rng.uniform(-np.sqrt(3), np.sqrt(3), size=shape)
        elif kind < self.laplace + self.uniform + self.anisotropic:
            noise = rng.normal(size=shape) * rng.uniform(0.2, 1.5, 3)
        else:  # a scanner: along the ray, in steps
            ray = clean - 2 * rng.normal(size=3)
            ray /= np.linalg.norm(ray, axis=1, keepdims=True)
            depth, step = rng.normal(size=(len(clean), 1)), rng.uniform(0.05, 1.5)
            noise = np.round(depth / step) * step * ray + 0.1 * rng.normal(size=shape)
        if rng.random() < self.outliers:
            wild = rng.random(len(clean)) < rng.uniform(0.005, 0.06)
            noise[wild] *= rng.uniform(2, 6, (int(wild.sum()), 1))
        return level * noise, float(level)
