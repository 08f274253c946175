"""Local coordinates of patches: centre, scale and PCA frame, computed patch by patch.

The Numba form works one patch at a time in float64, so that a patch's frame is the same bit for bit whatever the
batch it came in; its in-plane axes are ill-conditioned on an isotropic patch and would otherwise turn with the
last bit of the covariance. The torch form is the same arithmetic on any device.
"""

from __future__ import annotations

import numba as nb
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor


def local_patches(
    points: NDArray[np.float64],
    normals: NDArray[np.float32],
    index: NDArray[np.int64],
    radius: float | NDArray[np.float64],
    *,
    upward: bool,
    spin: NDArray[np.float64] | None = None,
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Gather patches and bring them into their PCA frames.

    Parameters
    ----------
    points : ndarray, (N, 3) float64
    normals : ndarray, (N, 3) float32
        Raw normals.
    index : ndarray, (B, M) int64
        Neighbours of each patch, the centre first; -1 is padding and becomes the centre.
    radius : float or ndarray, (B,) float64
        Patch radius in the unit of the points.
    upward : bool
        Flip the patch's normals to z >= 0 in the frame (normals have no sign).
    spin : ndarray, (B, 3, 3) float64, optional
        Applied on top of the frame; random in-plane rotations and reflections while training.

    Returns
    -------
    points : ndarray, (B, M, 3) float32
        In patch radii, centre at the origin; padding lies at the origin.
    normals : ndarray, (B, M, 3) float32
    frames : ndarray, (B, 3, 3) float32
        Rows are the frame's x, y, z axes (z of least variance): local = frames @ world.
    """
    shape = (*index.shape, 3)
    local, turned = np.empty(shape, np.float32), np.empty(shape, np.float32)
    frames = np.empty((len(index), 3, 3), np.float32)
    turns = np.empty((0, 3, 3)) if spin is None else spin
    radii = np.ascontiguousarray(np.broadcast_to(np.asarray(radius, np.float64), len(index)))
    _local_patches(points, normals, index, radii, upward, turns, local, turned, frames)
    return local, turned, frames


def principal_axes(points: NDArray[np.float64], index: NDArray[np.int64]) -> NDArray[np.float64]:
    """PCA axes (B, 3, 3) of neighbourhoods: rows of greatest, middle and least variance, float64.

    ``index`` (B, M) int64 lists the neighbours; -1 is left out.
    """
    axes = np.empty((len(index), 3, 3))
    _principal_axes(points, index, axes)
    return axes


def local_patches_torch(
    points: Tensor, normals: Tensor, index: Tensor, radius: float | Tensor, *, upward: bool
) -> tuple[Tensor, Tensor, Tensor]:
    """Do the same as :func:`local_patches` in torch operations, on any device; ``radius`` may be (B,)."""
    if isinstance(radius, Tensor):
        radius = radius[:, None, None]
    valid = index >= 0  # (B, M)
    index = torch.where(valid, index, index[:, :1])
    patch = (points[index] - points[index[:, :1]]) / radius  # (B, M, 3)
    mask = valid[..., None].to(patch.dtype)
    centred = (patch - (patch * mask).sum(1, keepdim=True) / mask.sum(1, keepdim=True)) * mask
    _, vectors = torch.linalg.eigh(centred.transpose(1, 2) @ centred)  # columns ascending
    z, x = vectors[..., 0], vectors[..., 2]
    frames = torch.stack([x, torch.linalg.cross(z, x), z], 1)  # (B, 3, 3)
    local = patch @ frames.transpose(1, 2)
    turned = normals[index].to(frames.dtype) @ frames.transpose(1, 2)
    if upward:
        turned = torch.where(turned[..., 2:] < 0, -turned, turned)
    return local.float(), turned.float(), frames.float()


@nb.njit(cache=True, nogil=True)
def symmetric_axes(xx, xy, xz, yy, yz, zz, out):  # type: ignore[no-untyped-def]
    """Eigenvectors of a symmetric 3x3 matrix by cyclic Jacobi rotations, as rows, largest eigenvalue first."""
    a = np.array(((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)))
    v = np.eye(3)
    for _ in range(12):
        off = a[0, 1] ** 2 + a[0, 2] ** 2 + a[1, 2] ** 2
        if off <= 1e-30 * (a[0, 0] ** 2 + a[1, 1] ** 2 + a[2, 2] ** 2):
            break
        for p, q in ((0, 1), (0, 2), (1, 2)):
            if a[p, q] == 0.0:
                continue
            theta = (a[q, q] - a[p, p]) / (2.0 * a[p, q])
            t = 1.0 / (abs(theta) + np.sqrt(theta * theta + 1.0))
            if theta < 0:
                t = -t
            c = 1.0 / np.sqrt(t * t + 1.0)
            s = t * c
            for k in range(3):
                low, high = a[k, p], a[k, q]
                a[k, p], a[k, q] = c * low - s * high, s * low + c * high
            for k in range(3):
                low, high = a[p, k], a[q, k]
                a[p, k], a[q, k] = c * low - s * high, s * low + c * high
            for k in range(3):
                low, high = v[k, p], v[k, q]
                v[k, p], v[k, q] = c * low - s * high, s * low + c * high
    big = 0
    small = 0
    for k in range(1, 3):
        if a[k, k] > a[big, big]:
            big = k
        if a[k, k] <= a[small, small]:
            small = k
    if big == small:
        big, small = 0, 2
    for k in range(3):
        out[0, k] = v[k, big]
        out[2, k] = v[k, small]
    out[1, 0] = out[2, 1] * out[0, 2] - out[2, 2] * out[0, 1]
    out[1, 1] = out[2, 2] * out[0, 0] - out[2, 0] * out[0, 2]
    out[1, 2] = out[2, 0] * out[0, 1] - out[2, 1] * out[0, 0]


@nb.njit(cache=True, nogil=True)
def _patch_axes(points, row, out):  # type: ignore[no-untyped-def]
    """Axes of one neighbourhood, relative to its first point."""
    i = row[0]
    mx = my = mz = 0.0
    count = 0
    for j in row:
        if j >= 0:
            mx += points[j, 0] - points[i, 0]
            my += points[j, 1] - points[i, 1]
            mz += points[j, 2] - points[i, 2]
            count += 1
    mx, my, mz = mx / count, my / count, mz / count
    xx = xy = xz = yy = yz = zz = 0.0
    for j in row:
        if j >= 0:
            x = points[j, 0] - points[i, 0] - mx
            y = points[j, 1] - points[i, 1] - my
            z = points[j, 2] - points[i, 2] - mz
            xx += x * x
            xy += x * y
            xz += x * z
            yy += y * y
            yz += y * z
            zz += z * z
    symmetric_axes(xx, xy, xz, yy, yz, zz, out)


@nb.njit(cache=True, nogil=True, parallel=True)
def _principal_axes(points, index, axes):  # type: ignore[no-untyped-def]
    for b in nb.prange(len(index)):
        _patch_axes(points, index[b], axes[b])


@nb.njit(cache=True, nogil=True, parallel=True)
def _local_patches(points, normals, index, radii, upward, spin, local, turned, frames):  # type: ignore[no-untyped-def]
    for b in nb.prange(len(index)):
        f = np.empty((3, 3))
        _patch_axes(points, index[b], f)
        if len(spin):
            f = np.dot(spin[b], f)
        for r in range(3):
            for c in range(3):
                frames[b, r, c] = f[r, c]
        i, radius = index[b, 0], radii[b]
        for m in range(index.shape[1]):
            j = index[b, m]
            if j < 0:
                j = i
            x = (points[j, 0] - points[i, 0]) / radius
            y = (points[j, 1] - points[i, 1]) / radius
            z = (points[j, 2] - points[i, 2]) / radius
            u, v, w = normals[j, 0], normals[j, 1], normals[j, 2]
            sign = 1.0
            if upward and f[2, 0] * u + f[2, 1] * v + f[2, 2] * w < 0:
                sign = -1.0
            for r in range(3):
                local[b, m, r] = f[r, 0] * x + f[r, 1] * y + f[r, 2] * z
                turned[b, m, r] = sign * (f[r, 0] * u + f[r, 1] * v + f[r, 2] * w)
