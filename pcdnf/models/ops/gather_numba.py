"""Numba kernels behind ``pcdnf.models.ops.neighbours``: gather-max and gather-mean, forward and backward.

Every kernel works on C-contiguous arrays, writes into arrays given by the caller, and shares its outermost
loop among ``numba.get_num_threads()`` threads. No kernel uses fast-math: ties and infinities keep their
meaning. Shapes: B patches, N points, Q queries, k neighbours, C channels.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float32]
Index = NDArray[np.int32]

_jit: Any = numba.njit(parallel=True, cache=True, nogil=True)


@_jit
def gather_max(values: Float, index: Index, out: Float) -> None:
    """Maximum over neighbours: values (B, N, C), index (B, Q, k) -> out (B, Q, C)."""
    B, Q, k = index.shape
    C = values.shape[2]
    for r in numba.prange(B * Q):
        b, q = r // Q, r % Q
        o = out[b, q]
        first = values[b, index[b, q, 0]]
        for c in range(C):
            o[c] = first[c]
        for t in range(1, k):
            v = values[b, index[b, q, t]]
            for c in range(C):
                o[c] = v[c] if v[c] > o[c] else o[c]


@_jit
def gather_argmax(values: Float, index: Index, out: Float, winner: Index) -> None:
    """As ``gather_max``, and winner (B, Q, C): the point each maximum came from (the first of equal ones)."""
    B, Q, k = index.shape
    C = values.shape[2]
    for r in numba.prange(B * Q):
        b, q = r // Q, r % Q
        o, w = out[b, q], winner[b, q]
        j = index[b, q, 0]
        first = values[b, j]
        for c in range(C):
            o[c] = first[c]
            w[c] = j
        for t in range(1, k):
            j = index[b, q, t]
            v = values[b, j]
            for c in range(C):
                w[c] = j if v[c] > o[c] else w[c]
                o[c] = v[c] if v[c] > o[c] else o[c]


@_jit
def gather_argmax_backward(grad: Float, winner: Index, grad_values: Float) -> None:
    """Add grad (B, Q, C) to the rows of grad_values (B, N, C) that won."""
    B, Q, C = grad.shape
    for b in numba.prange(B):
        for q in range(Q):
            for c in range(C):
                grad_values[b, winner[b, q, c], c] += grad[b, q, c]


@_jit
def gather_mean(values: Float, index: Index, out: Float) -> None:
    """Mean over neighbours: values (B, N, C), index (B, Q, k) -> out (B, Q, C)."""
    B, Q, k = index.shape
    C = values.shape[2]
    scale = np.float32(1.0 / k)
    for r in numba.prange(B * Q):
        b, q = r // Q, r % Q
        o = out[b, q]
        for c in range(C):
            o[c] = 0.0
        for t in range(k):
            v = values[b, index[b, q, t]]
            for c in range(C):
                o[c] += v[c]
        for c in range(C):
            o[c] *= scale


@_jit
def gather_mean_backward(grad: Float, index: Index, grad_values: Float) -> None:
    """Add grad (B, Q, C) / k to the rows of grad_values (B, N, C) that were averaged."""
    B, Q, k = index.shape
    C = grad.shape[2]
    scale = np.float32(1.0 / k)
    for b in numba.prange(B):
        for q in range(Q):
            g = grad[b, q]
            for t in range(k):
                v = grad_values[b, index[b, q, t]]
                for c in range(C):
                    v[c] += g[c] * scale
