"""Neighbours that lie on another sheet of surface: the other side of a thin wall, a web, a board.

On one smooth surface the chord to a neighbour rises above the centre's tangent plane by half the angle between their
normals. A neighbour that rises more steeply, by more than the noise explains, and yet has a parallel normal, belongs to
another sheet.
"""

from __future__ import annotations

import numba as nb
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

PARALLEL = 0.8
"""Cosine of two normals, up to sign, from which on they count as parallel."""
DEPTH = 5.0
"""Height above the tangent plane, in noises, that may be noise alone."""
SLACK, TURN = 0.15, 1.5
"""Slope that errors of the normals explain, and factor on the slope that their angle does."""
OPPOSED = -0.3
"""Cosine of given normals, which tell the sides apart, below which they face away from one another."""


def without_other_sheets(
    points: NDArray[np.float64],
    normals: NDArray[np.float32],
    index: NDArray[np.int64],
    noise: NDArray[np.float64],
    *,
    sided: bool,
) -> NDArray[np.int64]:
    """Leave the neighbours on another sheet out of patches.

    Parameters
    ----------
    points : ndarray, (N, 3) float64
    normals : ndarray, (N, 3) float32
        Unit normals.
    index : ndarray, (B, M) int64
        Neighbours, the centre first, -1 for padding.
    noise : ndarray, (N,) float64
        Around each point, in the unit of the points.
    sided : bool
        Whether the normals' signs tell the sides apart: then opposed ones are left out wherever they lie.

    Returns
    -------
    ndarray, (B, M) int64
        The same neighbours, with -1 in place of those left out.
    """
    kept = index.copy()
    _without_other_sheets(points, normals, kept, noise, sided)
    return kept


def without_other_sheets_torch(
    points: Tensor, normals: Tensor, index: Tensor, noise: Tensor, *, sided: bool = False
) -> Tensor:
    """Do the same as :func:`without_other_sheets` in torch operations, on any device."""
    filled = torch.where(index >= 0, index, index[:, :1])
    away = points[filled] - points[index[:, :1]]  # (B, M, 3)
    own = normals[index[:, :1]].double()
    height = (away * own).sum(-1).abs()
    flat = (away.square().sum(-1) - height.square()).clamp(min=0).sqrt()
    cosine = (normals[filled].double() * own).sum(-1)
    parallel = cosine.abs().clamp(max=1)
    slope = TURN * ((1 - parallel) / (1 + parallel)).sqrt() + SLACK
    other = (parallel > PARALLEL) & (height > DEPTH * noise[index[:, :1]] + slope * flat)
    if sided:
        other |= cosine < OPPOSED
    return torch.where(other, -1, index)


@nb.njit(cache=True, nogil=True, parallel=True)
def _without_other_sheets(points, normals, index, noise, sided):  # type: ignore[no-untyped-def]
    for b in nb.prange(len(index)):
        i = index[b, 0]
        u, v, w = np.float64(normals[i, 0]), np.float64(normals[i, 1]), np.float64(normals[i, 2])
        for m in range(1, index.shape[1]):
            j = index[b, m]
            if j < 0:
                continue
            cosine = normals[j, 0] * u + normals[j, 1] * v + normals[j, 2] * w
            if sided and cosine < OPPOSED:
                index[b, m] = -1
                continue
            parallel = min(abs(cosine), 1.0)
            if parallel <= PARALLEL:
                continue
            x, y, z = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1], points[j, 2] - points[i, 2]
            height = abs(x * u + y * v + z * w)
            rest = height - DEPTH * noise[i]
            if rest <= 0:
                continue
            flat = np.sqrt(max(x * x + y * y + z * z - height * height, 0.0))
            if rest > (TURN * np.sqrt((1 - parallel) / (1 + parallel)) + SLACK) * flat:
                index[b, m] = -1
