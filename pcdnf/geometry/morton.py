"""Spatial order of points along a Morton curve."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def spatial_order(local: NDArray[np.float64], bits: int = 10) -> NDArray[np.int64]:
    """Order local points (N, 3) along a Morton curve of ``bits`` a coordinate: indices (N,) int64."""
    cells = np.clip((local + 0.5) * (1 << bits), 0, (1 << bits) - 1).astype(np.int64)
    code = np.zeros(len(local), np.int64)
    for bit in range(bits):
        for axis in range(3):
            code |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable")
