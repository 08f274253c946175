"""Denoising where the noise is a small part of the spacing: by the largest neighbourhood that is flat within the noise.

A network cannot tell such slight noise from shape: its own error is some thousandths of a patch, many times the noise.
A quadric fit can, and leaves a point where no neighbourhood is flat. Neighbourhoods grow as long as their scatter is
explained by the noise and all fits agree within their uncertainty: the intersection of confidence intervals
(Goldenshluger and Nemirovski 1997, after Lepski).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from .quadric_scales import TERMS, fit_scales

SIZES = (9, 12, 18, 27, 40, 60, 90, 135)
"""Neighbours of the growing neighbourhoods."""
FEWEST = 18
"""Neighbours of the smallest one that a point is moved by."""
SCATTER = 1.5
"""Scatter, in noises, up to which a neighbourhood is flat; more for a small one, whose scatter is uncertain."""
AGREE = 2.5
"""Standard errors within which the fits must agree."""
LONGEST = 3.0
"""Longest move, in noises."""


def flat_fits(
    points: NDArray[np.float64], rows: NDArray[np.int64], noise: NDArray[np.float64], *, tree: cKDTree
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Move points onto fits of the largest neighbourhoods that are flat.

    Parameters
    ----------
    points : ndarray, (N, 3) float64
    rows : ndarray, (B,) int64
        Points to move.
    noise : ndarray, (B,) float64
        Standard deviation around each, in the unit of the points.
    tree : cKDTree
        Of the points.

    Returns
    -------
    move : ndarray, (B, 3) float64
        Zero where no neighbourhood is flat.
    normal : ndarray, (B, 3) float64
        Of the fit, without a consistent sign; NaN where there is none.
    """
    sizes = np.array([size for size in SIZES if size <= len(points)])
    if not len(sizes) or sizes[-1] < FEWEST:
        return np.zeros((len(rows), 3)), np.full((len(rows), 3), np.nan)
    fits = fit_scales(points, rows, sizes, tree=tree)
    tolerance = SCATTER * (1 + 1.5 / np.sqrt(2 * (sizes - TERMS)))
    error = AGREE * np.sqrt(fits.leverage) * noise[:, None]
    low = np.maximum.accumulate(fits.height - error, axis=1)
    high = np.minimum.accumulate(fits.height + error, axis=1)
    flat = (fits.scatter < tolerance * noise[:, None]) & (low <= high)
    count = np.logical_and.accumulate(flat, axis=1).sum(1)
    best = np.maximum(count - 1, 0)
    every = np.arange(len(rows))
    height, normal = fits.height[every, best], fits.normal[every, best]
    usable = (count > 0) & (sizes[best] >= FEWEST) & (np.abs(height) <= LONGEST * noise)
    return np.where(usable[:, None], height[:, None] * normal, 0.0), np.where((count > 0)[:, None], normal, np.nan)
