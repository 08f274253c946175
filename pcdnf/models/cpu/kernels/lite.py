# mypy: disallow-untyped-decorators=False
"""Numba kernels of the folded light network: the steps between its matrix products.

Each processes patches one after another on one thread; chunks of patches run in parallel. Feature
arrays are float32, or bfloat16 seen as uint16; features are computed in float32, the fit in float64. Shapes: B patches,
M neighbours, C channels.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from ...ops.bfloat16 import Features, Float, narrowed, widened
from .quadric import fit_points, residuals

EPSILON = 1e-5
"""Of LayerNorm."""
_inline: Any = numba.njit(cache=True, nogil=True, inline="always")
_jit: Any = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz"})


@_jit
def embed(
    points: Float, normals: Float, inner: Float, own: Float, bias: Float, slope: float, out: Features, valid: Any
) -> None:
    """First layer with its activation, on what is known of each neighbour, and which entries are no padding.

    points, normals (B, M, 3); inner (8, C): weights of point, distance, normal and their product; own (3, C): of the
    centre's normal, the same for the whole patch; bias (C,); out (B, M, C), valid (B, M) bool.
    """
    B, M, C = out.shape
    floor = np.float32(slope)
    base = np.empty(C, np.float32)
    for b in range(B):
        u, v, w = normals[b, 0]
        for c in range(C):
            base[c] = bias[c] + own[0, c] * u + own[1, c] * v + own[2, c] * w
        for i in range(0, M, 2):  # two at a time share the weights; the last stands in for one beyond the end
            j = min(i + 1, M - 1)
            x0, y0, z0 = points[b, i]
            x1, y1, z1 = points[b, j]
            u0, v0, w0 = normals[b, i]
            u1, v1, w1 = normals[b, j]
            far0, far1 = np.sqrt(x0 * x0 + y0 * y0 + z0 * z0), np.sqrt(x1 * x1 + y1 * y1 + z1 * z1)
            along0, along1 = x0 * u0 + y0 * v0 + z0 * w0, x1 * u1 + y1 * v1 + z1 * w1
            valid[b, j], valid[b, i] = far1 > 0, i == 0 or far0 > 0
            row0, row1 = out[b, i], out[b, j]
            for c in range(C):
                t0 = base[c] + x0 * inner[0, c] + y0 * inner[1, c] + z0 * inner[2, c] + far0 * inner[3, c]
                t1 = base[c] + x1 * inner[0, c] + y1 * inner[1, c] + z1 * inner[2, c] + far1 * inner[3, c]
                t0 += u0 * inner[4, c] + v0 * inner[5, c] + w0 * inner[6, c] + along0 * inner[7, c]
                t1 += u1 * inner[4, c] + v1 * inner[5, c] + w1 * inner[6, c] + along1 * inner[7, c]
                row0[c] = narrowed(t0 if t0 > 0 else floor * t0, out)
                row1[c] = narrowed(t1 if t1 > 0 else floor * t1, out)


@_jit
def normalise(features: Features, valid: Any, scale: Float, shift: Float, slope: float, context: Float) -> None:
    """LayerNorm and activation in place, and their maximum and mean over the neighbours.

    features (B, M, C), valid (B, M) bool: no padding; scale, shift (C,), context (B, 2 C).
    """
    B, M, C = features.shape
    floor, share = np.float32(slope), np.float32(1.0 / C)
    row = np.empty(C, np.float32)
    for b in range(B):
        highest, mean = context[b, :C], context[b, C:]
        highest[:] = -np.inf
        mean[:] = 0
        count = 0
        for i in range(M):
            feature = features[b, i]
            total = square = np.float32(0)
            for c in range(C):
                x = widened(feature[c])
                row[c] = x
                total += x
                square += x * x
            total *= share
            factor = _inverse(square * share - total * total)
            if valid[b, i]:
                count += 1
                for c in range(C):
                    t = (row[c] - total) * factor * scale[c] + shift[c]
                    t = t if t > 0 else floor * t
                    feature[c] = narrowed(t, features)
                    highest[c] = t if t > highest[c] else highest[c]
                    mean[c] += t
            else:
                for c in range(C):
                    t = (row[c] - total) * factor * scale[c] + shift[c]
                    feature[c] = narrowed(t if t > 0 else floor * t, features)
        for c in range(C):
            mean[c] /= np.float32(count)


@_inline
def _inverse(variance: Any) -> Any:
    """Return the factor of LayerNorm; rounding may leave a variance of zero negative."""
    return np.float32(1) / np.sqrt(max(variance, np.float32(0)) + np.float32(EPSILON))


@_jit
def activate(hidden: Features, context: Float, slope: float) -> None:
    """Add a patch's context (B, C) to hidden (B, M, C) and apply the activation, in place."""
    B, M, C = hidden.shape
    floor = np.float32(slope)
    for b in range(B):
        for i in range(M):
            row = hidden[b, i]
            for c in range(C):
                t = widened(row[c]) + context[b, c]
                row[c] = narrowed(t if t > 0 else floor * t, hidden)


@_jit
def add_normalise(
    features: Features,
    more: Features,
    scale: Float,
    shift: Float,
    slope: float,
    weight: Float,
    bias: float,
    score: Float,
) -> None:
    """Sum, LayerNorm and activation in place, and a score.

    features, more (B, M, C), scale, shift, weight (C,), score (B, M).
    """
    B, M, C = features.shape
    floor, share = np.float32(slope), np.float32(1.0 / C)
    row = np.empty(C, np.float32)
    for b in range(B):
        for i in range(M):
            feature, other = features[b, i], more[b, i]
            total = square = np.float32(0)
            for c in range(C):
                x = widened(feature[c]) + widened(other[c])
                row[c] = x
                total += x
                square += x * x
            total *= share
            factor = _inverse(square * share - total * total)
            sum_ = np.float32(bias)
            for c in range(C):
                t = (row[c] - total) * factor * scale[c] + shift[c]
                t = t if t > 0 else floor * t
                sum_ += weight[c] * t
                feature[c] = narrowed(t, features)
            score[b, i] = sum_


@_jit
def scores(hidden: Features, context: Float, slope: float, weight: Float, bias: Float, out: Float) -> None:
    """Activation of hidden (B, M, C) + context (B, C), and two scores out (2, B, M) by weight (2, C) and bias (2,)."""
    B, M, C = hidden.shape
    floor = np.float32(slope)
    for b in range(B):
        for i in range(M):
            row = hidden[b, i]
            s, t = bias[0], bias[1]
            for c in range(C):
                h = widened(row[c]) + context[b, c]
                h = h if h > 0 else floor * h
                s += h * weight[0, c]
                t += h * weight[1, c]
            out[0, b, i], out[1, b, i] = s, t


@_jit
def against(
    features: Features,
    points: Float,
    normals: Float,
    weights: Float,
    ridge: Float,
    inner: Float,
    bias: Float,
    context: Float,
) -> None:
    """First fit, and what is left of each neighbour above it, added to its features; their maximum and mean.

    features (B, M, C); points, normals (B, M, 3); weights (B, M), 0 for padding; ridge (6,); inner (4, C), bias (C,):
    the layer on height above the fit, its size, weight and cosine of the normals; context (B, 2 C).
    """
    B, M, C = features.shape
    fit = np.empty(6)
    height, cosine = np.empty(M, np.float32), np.empty(M, np.float32)
    for b in range(B):
        fit_points(points[b], weights[b], ridge, fit)
        residuals(points[b], normals[b], fit.astype(np.float32), height, cosine)
        highest, mean = context[b, :C], context[b, C:]
        highest[:] = -np.inf
        mean[:] = 0
        count = 0
        for i in range(M):
            above, size, weight, along = height[i], abs(height[i]), weights[b, i], cosine[i]
            row = features[b, i]
            if weight == 0:  # padding: nobody reads its features any more
                continue
            count += 1
            for c in range(C):
                f = widened(row[c]) + bias[c] + above * inner[0, c] + size * inner[1, c]
                f += weight * inner[2, c] + along * inner[3, c]
                row[c] = narrowed(f, features)
                highest[c] = f if f > highest[c] else highest[c]
                mean[c] += f
        for c in range(C):
            mean[c] /= np.float32(count)
