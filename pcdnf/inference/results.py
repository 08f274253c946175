"""Results of a tile and of a run."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .diagnostics import Diagnostics


@dataclass(frozen=True)
class TileResult:
    """Result of the points ``cloud.order[start:stop]``, in that order.

    Attributes
    ----------
    points : ndarray, (n, 3) float64
        In the unit and coordinates of the input.
    normals : ndarray, (n, 3) float32
    flagged : ndarray, (n,) bool
        Points returned as they came.
    """

    points: NDArray[np.float64]
    normals: NDArray[np.float32]
    flagged: NDArray[np.bool_]


@dataclass(frozen=True)
class DenoiseResult:
    """A denoised cloud, in the order of the input.

    Attributes
    ----------
    points : ndarray, (N, 3) float64
    normals : ndarray, (N, 3) float32
        Unit length, on the side of the input's normal where there was one.
    flagged : ndarray, (N,) bool
        Points without enough neighbours, returned as they came.
    metadata : dict of str
        Model, weights' hash, device, precision, seed, initial normals, iterations, radius, version: enough to repeat
        the run; with them the shares of points that were moved, left, and moved doubtfully far.
    diagnostics : Diagnostics, optional
        Of each point. For a radius that the caller chose, or a network of one radius, the noise is one for all points.
    """

    points: NDArray[np.float64]
    normals: NDArray[np.float32]
    flagged: NDArray[np.bool_]
    metadata: dict[str, str] = field(default_factory=dict)
    diagnostics: Diagnostics | None = None
