# mypy: disallow-untyped-decorators=False
"""Numba kernels of the weighted quadric fit, one patch at a time, without intermediate results in memory.

The normal equations of a quadric hold 15 different moments of x and y; they are summed, and the 6 x 6 system solved, in
float64. Shapes: M neighbours.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float32]
Double = NDArray[np.float64]

_jit: Any = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz"})


@_jit
def fit_points(points: Float, weights: Float, ridge: Float, fit: Double) -> None:
    """Points (M, 3), weights (M,) of positive sum, ridge (6,) as in ``fit_quadric`` -> coefficients fit (6,)."""
    gram = np.empty((6, 6))
    total = _equations(points, weights, gram, fit)
    _scale(gram, fit, total)
    _solve(gram, ridge, fit)


@_jit
def fit_points_and_slopes(
    points: Float, weights: Float, normals: Float, slope_weights: Float, ridge: Float, fit: Double
) -> None:
    """As :func:`fit_points`; normals (M, 3) by slope_weights (M,), relative to the points', ask for their slopes."""
    gram = np.empty((6, 6))
    total = _equations(points, weights, gram, fit)
    _slope_equations(points, weights, normals, slope_weights, gram, fit)
    _scale(gram, fit, total)
    _solve(gram, ridge, fit)


@_jit
def _equations(points: Float, weights: Float, gram: Double, right: Double) -> float:
    """Lower half of gram (6, 6), right (6,) of ``z = a + b x + c y + d x^2 + e x y + f y^2``; sum of the weights."""
    m0 = m1 = m2 = m3 = m4 = m5 = m6 = m7 = m8 = m9 = m10 = m11 = m12 = m13 = m14 = 0.0
    r0 = r1 = r2 = r3 = r4 = r5 = 0.0
    for i in range(len(weights)):
        x, y, z = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        w = np.float64(weights[i])
        wx, wy = w * x, w * y
        wxx, wxy, wyy = wx * x, wx * y, wy * y
        m0 += w
        m1 += wx
        m2 += wy
        m3 += wxx
        m4 += wxy
        m5 += wyy
        m6 += wxx * x
        m7 += wxx * y
        m8 += wyy * x
        m9 += wyy * y
        m10 += wxx * x * x
        m11 += wxx * x * y
        m12 += wxx * y * y
        m13 += wyy * x * y
        m14 += wyy * y * y
        r0 += w * z
        r1 += wx * z
        r2 += wy * z
        r3 += wxx * z
        r4 += wxy * z
        r5 += wyy * z
    gram[0, 0] = m0
    gram[1, 0], gram[1, 1] = m1, m3
    gram[2, 0], gram[2, 1], gram[2, 2] = m2, m4, m5
    gram[3, 0], gram[3, 1], gram[3, 2], gram[3, 3] = m3, m6, m7, m10
    gram[4, 0], gram[4, 1], gram[4, 2], gram[4, 3], gram[4, 4] = m4, m7, m8, m11, m12
    gram[5, 0], gram[5, 1], gram[5, 2], gram[5, 3], gram[5, 4], gram[5, 5] = m5, m8, m9, m12, m13, m14
    right[0], right[1], right[2], right[3], right[4], right[5] = r0, r1, r2, r3, r4, r5
    return m0


@_jit
def _slope_equations(
    points: Float, weights: Float, normals: Float, slope_weights: Float, gram: Double, right: Double
) -> None:
    """Add the equations ``b + 2 d x + e y = -u / w`` and ``c + e x + 2 f y = -v / w``, weighted by w squared."""
    m0 = m1 = m2 = m3 = m4 = m5 = 0.0
    u0 = u1 = u2 = v0 = v1 = v2 = 0.0
    for i in range(len(weights)):
        x, y = np.float64(points[i, 0]), np.float64(points[i, 1])
        share = np.float64(weights[i]) * np.float64(slope_weights[i]) * np.float64(normals[i, 2])
        w, u, v = share * normals[i, 2], share * normals[i, 0], share * normals[i, 1]
        wx, wy = w * x, w * y
        m0 += w
        m1 += wx
        m2 += wy
        m3 += wx * x
        m4 += wx * y
        m5 += wy * y
        u0 += u
        u1 += u * x
        u2 += u * y
        v0 += v
        v1 += v * x
        v2 += v * y
    gram[1, 1] += m0
    gram[2, 2] += m0
    gram[3, 1] += 2 * m1
    gram[4, 1] += m2
    gram[4, 2] += m1
    gram[5, 2] += 2 * m2
    gram[3, 3] += 4 * m3
    gram[4, 3] += 2 * m4
    gram[4, 4] += m3 + m5
    gram[5, 4] += 2 * m4
    gram[5, 5] += 4 * m5
    right[1] -= u0
    right[2] -= v0
    right[3] -= 2 * u1
    right[4] -= u2 + v1
    right[5] -= 2 * v2


@_jit
def _scale(gram: Double, right: Double, total: float) -> None:
    """Weights of sum 1."""
    for j in range(6):
        right[j] /= total
        for k in range(j + 1):
            gram[j, k] /= total


@_jit
def _solve(gram: Double, ridge: Float, right: Double) -> None:
    """(gram + ridge)^-1 right, in place, by Cholesky; gram's lower half is overwritten."""
    for j in range(6):
        gram[j, j] += ridge[j]
        for k in range(j + 1):
            t = gram[j, k]
            for i in range(k):
                t -= gram[j, i] * gram[k, i]
            gram[j, k] = np.sqrt(t) if j == k else t / gram[k, k]
        t = right[j]
        for k in range(j):
            t -= gram[j, k] * right[k]
        right[j] = t / gram[j, j]
    for j in range(5, -1, -1):
        t = right[j]
        for k in range(j + 1, 6):
            t -= gram[k, j] * right[k]
        right[j] = t / gram[j, j]


@_jit
def fit_patches(points: Float, weights: Float, normals: Float, slope_weights: Float, ridge: Float, fits: Float) -> None:
    """:func:`fit_points_and_slopes` of B patches: (B, M, 3), (B, M), (B, M, 3), (B, M), ridge (B, 6) -> fits (B, 6)."""
    fit = np.empty(6)
    for b in range(len(points)):
        fit_points_and_slopes(points[b], weights[b], normals[b], slope_weights[b], ridge[b], fit)
        fits[b] = fit


@_jit
def residuals(points: Float, normals: Float, fit: Float, height: Float, cosine: Float) -> None:
    """Four times the height (M,) of points (M, 3) above a fit (6,), at most 8, and the cosine (M,) of their normals."""
    h, p, q, r, s, t = fit
    one, two, most = np.float32(1), np.float32(2), np.float32(8)
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        along_x, along_y = p + two * r * x + s * y, q + s * x + two * t * y
        above = np.float32(4) * (z - (h + x * (p + r * x + s * y) + y * (q + t * y)))
        height[i] = min(max(above, -most), most)
        dot = normals[i, 2] - normals[i, 0] * along_x - normals[i, 1] * along_y
        cosine[i] = dot / np.sqrt(one + along_x * along_x + along_y * along_y)
