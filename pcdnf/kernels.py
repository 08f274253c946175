"""Numba kernels behind ``pcdnf.neighbors``: selection of neighbours, gather-max, gather-mean.

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
_inline: Any = numba.njit(cache=True, nogil=True, inline="always")


@_inline
def _insert(key: Any, j: int, keys: Any, row: Any) -> None:
    """Put candidate j, whose key is below the last, into the ascending list; its first slot stays."""
    t = row.shape[0] - 1
    while t > 1 and keys[t - 1] > key:
        keys[t] = keys[t - 1]
        row[t] = row[t - 1]
        t -= 1
    keys[t] = key
    row[t] = j


@_jit
def select_features(gram: Float, queries: Index, index: Index) -> None:
    """The k nearest points from inner products: gram (B, N, N), queries (B, Q) -> index (B, Q, k).

    The rank of candidate q for point p is that of ``|q|^2 - 2 p.q``: the term ``|p|^2`` is the same for all.
    """
    B, Q, k = index.shape
    N = gram.shape[1]
    for r in numba.prange(B * Q):
        b = r // Q
        p = queries[b, r % Q]
        row = index[b, r % Q]
        keys = np.full(k, np.inf, np.float32)
        row[:] = p
        products = gram[b, p]
        if k > 1:
            for j in range(N):
                key = gram[b, j, j] - np.float32(2.0) * products[j]
                if key < keys[k - 1] and j != p:
                    _insert(key, j, keys, row)


@_jit
def select_coordinates(points: Float, queries: Index, index: Index) -> None:
    """The k nearest points in 3-D: points (B, N, 3), queries (B, Q) -> index (B, Q, k)."""
    B, Q, k = index.shape
    N = points.shape[1]
    for r in numba.prange(B * Q):
        b = r // Q
        p = queries[b, r % Q]
        row = index[b, r % Q]
        keys = np.full(k, np.inf, np.float32)
        row[:] = p
        if k > 1:
            px, py, pz = points[b, p, 0], points[b, p, 1], points[b, p, 2]
            for j in range(N):
                dx, dy, dz = points[b, j, 0] - px, points[b, j, 1] - py, points[b, j, 2] - pz
                key = dx * dx + dy * dy + dz * dz
                if key < keys[k - 1] and j != p:
                    _insert(key, j, keys, row)


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
    """Adds grad (B, Q, C) to the rows of grad_values (B, N, C) that won."""
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
    """Adds grad (B, Q, C) / k to the rows of grad_values (B, N, C) that were averaged."""
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
