# mypy: disallow-untyped-decorators=False
"""Numba kernel of the folded network's geometric anchor: what the selector learns from a first fit.

It processes patches one after another on one thread; chunks of patches run in parallel. Features are
float32, or bfloat16 seen as uint16. Shapes: B patches, M points, C channels.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

from ...ops.bfloat16 import Features, Float, narrowed, widened
from .quadric import fit_points, residuals

_jit: Any = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz"})


@_jit
def first_fit(
    guides: Features,
    points: Float,
    normals: Float,
    floor: float,
    ridge: Float,
    first: Float,
    first_bias: float,
    inner: Float,
    bias: Float,
    steer: Float,
    steer_bias: float,
    slope_weights: Float,
) -> None:
    """Fit by a first score, what is left of each point above it added to its guide, and a score of the sum.

    guides (B, M, C), in place; points, normals (B, M, 3); floor: added to every weight; ridge (6,); first, steer (C,):
    the scores' layers; inner (4, C), bias (C,): the layer on height above the fit, its size, weight and cosine of the
    normals; slope_weights (B, M): the second score's sigmoid.
    """
    B, M, C = guides.shape
    fit = np.empty(6)
    score, weight = np.empty(M, np.float32), np.empty(M, np.float32)
    height, cosine = np.empty(M, np.float32), np.empty(M, np.float32)
    for b in range(B):
        for i in range(M):
            score[i] = _sigmoid(_dot(guides[b, i], first) + np.float32(first_bias))
            x, y, z = points[b, i]
            real = i == 0 or x != 0 or y != 0 or z != 0
            weight[i] = score[i] + np.float32(floor) if real else np.float32(0)
        fit_points(points[b], weight, ridge, fit)
        residuals(points[b], normals[b], fit.astype(np.float32), height, cosine)
        for i in range(M):
            above, size, share, along = height[i], abs(height[i]), score[i], cosine[i]
            row = guides[b, i]
            total = np.float32(0)
            for c in range(C):
                g = widened(row[c]) + bias[c] + above * inner[0, c] + size * inner[1, c]
                g += share * inner[2, c] + along * inner[3, c]
                total += g * steer[c]
                row[c] = narrowed(g, guides)
            slope_weights[b, i] = _sigmoid(total + np.float32(steer_bias))


@_jit
def _dot(features: Features, weight: Float) -> np.float32:
    total = np.float32(0)
    for c in range(len(weight)):
        total += widened(features[c]) * weight[c]
    return total


@_jit
def _sigmoid(x: np.float32) -> np.float32:
    return np.float32(1) / (np.float32(1) + np.float32(math.exp(-x)))
