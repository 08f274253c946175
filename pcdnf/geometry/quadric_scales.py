"""Quadric fits of growing neighbourhoods, with what each says about noise and shape at its centre.

Every neighbourhood is fitted in its own PCA frame, in float64, so that a fit is the same bit for bit whatever else is
fitted with it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba as nb
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from .frames import symmetric_axes

TERMS = 6
"""Coefficients of a quadric height field."""
CHUNK = 4096
"""Centres whose neighbour lists are held at once."""


@dataclass(frozen=True)
class ScaleFits:
    """Fits of B centres at S scales each, in the unit of the points.

    Attributes
    ----------
    scatter : ndarray, (B, S) float64
        Standard deviation of the neighbours about the fit; NaN where there is none.
    radius : ndarray, (B, S) float64
        Distance of the farthest neighbour.
    height : ndarray, (B, S) float64
        Signed distance from the centre to the fit, along ``normal``.
    leverage : ndarray, (B, S) float64
        Variance of ``height`` in units of the noise's.
    normal : ndarray, (B, S, 3) float64
        Unit normal of the fit at the centre.
    kurtosis : ndarray, (B, S) float64
        Of the neighbours' heights above the fit: 3 for Gaussian noise, 1 for two thin sheets.
    """

    scatter: NDArray[np.float64]
    radius: NDArray[np.float64]
    height: NDArray[np.float64]
    leverage: NDArray[np.float64]
    normal: NDArray[np.float64]
    kurtosis: NDArray[np.float64]


def fit_scales(
    points: NDArray[np.float64], centres: NDArray[np.int64], sizes: NDArray[np.int64], *, tree: cKDTree, most: int = 0
) -> ScaleFits:
    """Fit quadrics to the nearest neighbours of some points, at several sizes.

    Parameters
    ----------
    points : ndarray, (N, 3) float64
    centres : ndarray, (B,) int64
        Rows of the points.
    sizes : ndarray, (S,) int64
        Neighbours of each scale, the centre among them, ascending, more than six and at most N.
    tree : cKDTree
        Of the points.
    most : int
        Neighbours that a fit takes at most, evenly spread over the distances; 0 for all.

    Returns
    -------
    ScaleFits
    """
    out = np.empty((len(centres), len(sizes), 8))
    largest = int(sizes[-1])
    for start in range(0, len(centres), CHUNK):
        rows = centres[start : start + CHUNK]
        _, index = tree.query(points[rows], largest, workers=-1)
        _fit_scales(points, rows, np.asarray(index, np.int64), sizes, most or largest, out[start : start + CHUNK])
    return ScaleFits(out[..., 0], out[..., 1], out[..., 2], out[..., 3], out[..., 4:7], out[..., 7])


@nb.njit(cache=True, nogil=True)
def _cholesky(gram):  # type: ignore[no-untyped-def]
    """Replace the lower half of a (6, 6) matrix by its Cholesky factor; whether it is positive."""
    for i in range(TERMS):
        for j in range(i + 1):
            rest = gram[i, j]
            for k in range(j):
                rest -= gram[i, k] * gram[j, k]
            if i > j:
                gram[i, j] = rest / gram[j, j]
            elif rest > 1e-14:
                gram[i, i] = np.sqrt(rest)
            else:
                return False
    return True


@nb.njit(cache=True, nogil=True)
def _solve(factor, right, out):  # type: ignore[no-untyped-def]
    """Solve the normal equations; return the first diagonal entry of their inverse."""
    for i in range(TERMS):
        rest = right[i]
        for k in range(i):
            rest -= factor[i, k] * out[k]
        out[i] = rest / factor[i, i]
    for i in range(TERMS - 1, -1, -1):
        rest = out[i]
        for k in range(i + 1, TERMS):
            rest -= factor[k, i] * out[k]
        out[i] = rest / factor[i, i]
    first = np.empty(TERMS)
    leverage = 0.0
    for i in range(TERMS):
        rest = 1.0 if i == 0 else 0.0
        for k in range(i):
            rest -= factor[i, k] * first[k]
        first[i] = rest / factor[i, i]
        leverage += first[i] * first[i]
    return leverage


@nb.njit(cache=True, nogil=True)
def _moments(points, at, index, size, stride, out):  # type: ignore[no-untyped-def]
    """PCA axes of the neighbours about their mean, into ``out``."""
    mx = my = mz = xx = xy = xz = yy = yz = zz = 0.0
    count = 0
    for m in range(0, size, stride):
        j = index[m]
        u, v, w = points[j, 0] - at[0], points[j, 1] - at[1], points[j, 2] - at[2]
        mx, my, mz = mx + u, my + v, mz + w
        xx, xy, xz = xx + u * u, xy + u * v, xz + u * w
        yy, yz, zz = yy + v * v, yz + v * w, zz + w * w
        count += 1
    mx, my, mz = mx / count, my / count, mz / count
    xx, xy, xz = xx / count - mx * mx, xy / count - mx * my, xz / count - mx * mz
    yy, yz, zz = yy / count - my * my, yz / count - my * mz, zz / count - mz * mz
    symmetric_axes(xx, xy, xz, yy, yz, zz, out)


@nb.njit(cache=True, nogil=True)
def _normal_equations(points, at, index, size, stride, radius, axes, gram, right):  # type: ignore[no-untyped-def]
    """Sum the normal equations of a quadric over the neighbours; return their number."""
    gram[:], right[:] = 0.0, 0.0
    design = np.empty(TERMS)
    count = 0
    for m in range(0, size, stride):
        j = index[m]
        u, v, w = (points[j, 0] - at[0]) / radius, (points[j, 1] - at[1]) / radius, (points[j, 2] - at[2]) / radius
        x = axes[0, 0] * u + axes[0, 1] * v + axes[0, 2] * w
        y = axes[1, 0] * u + axes[1, 1] * v + axes[1, 2] * w
        z = axes[2, 0] * u + axes[2, 1] * v + axes[2, 2] * w
        design[0], design[1], design[2], design[3], design[4], design[5] = 1.0, x, y, x * x, x * y, y * y
        for i in range(TERMS):
            right[i] += design[i] * z
            for k in range(i + 1):
                gram[i, k] += design[i] * design[k]
        count += 1
    for i in range(TERMS):
        gram[i, i] += 1e-9 * count
    return count


@nb.njit(cache=True, nogil=True)
def _residuals(points, at, index, size, stride, radius, axes, fit):  # type: ignore[no-untyped-def]
    """Mean squared and mean fourth power of the neighbours' heights above a fit."""
    two = four = 0.0
    count = 0
    for m in range(0, size, stride):
        j = index[m]
        u, v, w = (points[j, 0] - at[0]) / radius, (points[j, 1] - at[1]) / radius, (points[j, 2] - at[2]) / radius
        x = axes[0, 0] * u + axes[0, 1] * v + axes[0, 2] * w
        y = axes[1, 0] * u + axes[1, 1] * v + axes[1, 2] * w
        z = axes[2, 0] * u + axes[2, 1] * v + axes[2, 2] * w
        z -= fit[0] + x * (fit[1] + fit[3] * x + fit[4] * y) + y * (fit[2] + fit[5] * y)
        two, four = two + z * z, four + z**4
        count += 1
    return two / count, four / count


@nb.njit(cache=True, nogil=True, parallel=True)
def _fit_scales(points, centres, index, sizes, most, out):  # type: ignore[no-untyped-def]
    for b in nb.prange(len(centres)):
        at = points[centres[b]]
        axes, gram = np.empty((3, 3)), np.empty((TERMS, TERMS))
        right, fit = np.empty(TERMS), np.empty(TERMS)
        for s in range(len(sizes)):
            size = sizes[s]
            stride = (size + most - 1) // most
            far = points[index[b, size - 1]]
            radius = np.sqrt((far[0] - at[0]) ** 2 + (far[1] - at[1]) ** 2 + (far[2] - at[2]) ** 2)
            out[b, s, :] = np.nan
            if radius <= 0:
                continue
            _moments(points, at, index[b], size, stride, axes)
            count = _normal_equations(points, at, index[b], size, stride, radius, axes, gram, right)
            if count <= TERMS or not _cholesky(gram):
                continue
            leverage = _solve(gram, right, fit)
            two, four = _residuals(points, at, index[b], size, stride, radius, axes, fit)
            slant = np.sqrt(1.0 + fit[1] * fit[1] + fit[2] * fit[2])
            out[b, s, 0] = np.sqrt(two * count / (count - TERMS)) * radius
            out[b, s, 1] = radius
            out[b, s, 2] = fit[0] / slant * radius
            out[b, s, 3] = leverage
            for i in range(3):
                out[b, s, 4 + i] = (axes[2, i] - fit[1] * axes[0, i] - fit[2] * axes[1, i]) / slant
            out[b, s, 7] = four / max(two * two, 1e-300)
