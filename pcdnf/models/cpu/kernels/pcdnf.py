# mypy: disallow-untyped-decorators=False
"""Numba kernels of the folded network: the steps between its matrix products, each in one loop.

Feature arrays are float32, or bfloat16 seen as uint16; all arithmetic is float32. Shapes: B patches, M points,
K selected points, k neighbours, C channels.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

from ...ops.bfloat16 import Features, Float, Index, narrowed, widened

ROWS = 32
"""Points of a patch that a thread takes at a time."""

_jit: Any = numba.njit(parallel=True, cache=True, nogil=True)
_sums: Any = numba.njit(parallel=True, cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"})
_inline: Any = numba.njit(cache=True, nogil=True, inline="always")


@_jit
def edge_conv(
    projected: Features,
    near: int,
    own: int,
    graph: Index,
    k: int,
    scale: Float,
    slope: float,
    out: Features,
    start: int,
) -> None:
    """EdgeConv behind its linear layers, with BatchNorm folded.

    projected (B, N, .): neighbour part in channels ``near`` on, centre part (with bias) in channels ``own`` on; graph
    (B, N, >= k); scale (C,); out (B, N, .): C channels from ``start`` on.
    """
    B, N, _ = graph.shape
    C = scale.shape[0]
    blocks = (N + ROWS - 1) // ROWS
    floor = np.float32(slope)
    for job in numba.prange(B * blocks):
        b, first = job // blocks, job % blocks * ROWS
        best = np.empty(C, np.float32)
        for i in range(first, min(first + ROWS, N)):
            best[:] = -np.inf
            for t in range(0, k, 4):  # four at a time; the last stands in for those beyond the end
                v0 = projected[b, graph[b, i, t], near : near + C]
                v1 = projected[b, graph[b, i, min(t + 1, k - 1)], near : near + C]
                v2 = projected[b, graph[b, i, min(t + 2, k - 1)], near : near + C]
                v3 = projected[b, graph[b, i, min(t + 3, k - 1)], near : near + C]
                for c in range(C):
                    x0, x1, x2, x3 = widened(v0[c]), widened(v1[c]), widened(v2[c]), widened(v3[c])
                    x0 = x0 if x0 > x1 else x1
                    x2 = x2 if x2 > x3 else x3
                    x0 = x0 if x0 > x2 else x2
                    best[c] = x0 if x0 > best[c] else best[c]
            centre = projected[b, i, own : own + C]
            row = out[b, i, start : start + C]
            for c in range(C):
                x = widened(centre[c]) + scale[c] * best[c]
                row[c] = narrowed(x if x > 0 else floor * x, out)


@_inline
def _refine(hidden: Any, weight: Any, bias: Any, x: Any, out: Any) -> None:
    """Last layer of an extractor's head: hidden (., C) and weight (3, C) -> out (3,), added to the input x."""
    t0, t1, t2 = bias[0], bias[1], bias[2]
    for c in range(weight.shape[1]):
        h = widened(hidden[c])
        t0 += h * weight[0, c]
        t1 += h * weight[1, c]
        t2 += h * weight[2, c]
    out[0], out[1], out[2] = x[0] + t0, x[1] + t1, x[2] + t2


@_jit
def guide(
    points: Float,
    normals: Float,
    point_hidden: Features,
    normal_hidden: Features,
    point_weight: Float,
    point_bias: Float,
    normal_weight: Float,
    normal_bias: Float,
    angle: Float,
    distance: Float,
    refined_points: Float,
    refined_normals: Float,
    out: Features,
) -> None:
    """Refined points and normals, and the selector's input.

    points, normals (B, M, 3); hidden (B, M, 128): 64 channels of the head, 64 of the selector; weights (3, 64), biases
    (3,) of the head's last layer; angle, distance (2, 32): weight and bias; refined (B, M, 3); out (B, M, 192).
    """
    B, M, _ = points.shape
    half = point_weight.shape[1]
    wide = angle.shape[1]
    blocks = (M + ROWS - 1) // ROWS
    zero = np.float32(0.0)
    for job in numba.prange(B * blocks):
        b, first = job // blocks, job % blocks * ROWS
        for i in range(first, min(first + ROWS, M)):
            p, n, row = refined_points[b, i], refined_normals[b, i], out[b, i]
            _refine(point_hidden[b, i], point_weight, point_bias, points[b, i], p)
            _refine(normal_hidden[b, i], normal_weight, normal_bias, normals[b, i], n)
            for c in range(half):
                row[c] = point_hidden[b, i, half + c]
                row[half + c] = normal_hidden[b, i, half + c]
            x, y, z = p[1] * n[2] - p[2] * n[1], p[2] * n[0] - p[0] * n[2], p[0] * n[1] - p[1] * n[0]
            along = p[0] * n[0] + p[1] * n[1] + p[2] * n[2]
            a = np.float32(math.atan2(np.sqrt(x * x + y * y + z * z), along))
            d = np.float32(math.exp(-(p[0] * p[0] + p[1] * p[1] + p[2] * p[2])))
            for c in range(wide):
                u, v = angle[0, c] * a + angle[1, c], distance[0, c] * d + distance[1, c]
                row[2 * half + c] = narrowed(u if u > 0 else zero, out)
                row[2 * half + wide + c] = narrowed(v if v > 0 else zero, out)


@_jit
def score(channels: Features, slope: float, weight: Float, selected: Index) -> None:
    """Weights and the points of largest weight: channels (B, M, C) -> weight (B, M), selected (B, K), ascending.

    Of equal weights the lower index is taken.
    """
    B, M, C = channels.shape
    K = selected.shape[1]
    lanes = 16
    whole = C // lanes * lanes
    floor = np.float32(slope)
    for b in numba.prange(B):
        best = np.empty(lanes, np.float32)
        logits = np.empty(M, np.float32)
        for i in range(M):
            row = channels[b, i]
            best[:] = -np.inf
            for first in range(0, whole, lanes):
                part = row[first : first + lanes]
                for c in range(lanes):
                    x = widened(part[c])
                    best[c] = x if x > best[c] else best[c]
            for c in range(whole, C):
                best[0] = max(best[0], widened(row[c]))
            x = best.max()
            x = x if x > 0 else floor * x
            logits[i] = x
            weight[b, i] = np.float32(1.0) / (np.float32(1.0) + np.float32(math.exp(-x)))
        bound = np.sort(logits)[M - K]
        ties = K
        for i in range(M):
            ties -= logits[i] > bound
        count = 0
        for i in range(M):
            tied = logits[i] == bound and ties > 0
            if (logits[i] > bound or tied) and count < K:
                ties -= tied
                selected[b, count] = i
                count += 1


@_jit
def augment(own: Features, near: Features, weight: Float, selected: Index, graph: Index, out: Features) -> None:
    """own[selected] + mean over graph of weight * near: features (B, M, C), selected (B, K), graph (B, K, k)."""
    B, K, k = graph.shape
    C = own.shape[2]
    blocks = (K + ROWS - 1) // ROWS
    share = np.float32(1.0 / k)
    for job in numba.prange(B * blocks):
        b, first = job // blocks, job % blocks * ROWS
        total = np.empty(C, np.float32)
        for i in range(first, min(first + ROWS, K)):
            v = own[b, selected[b, i]]
            for c in range(C):
                total[c] = widened(v[c])
            for t in range(k):
                j = graph[b, i, t]
                w = share * weight[b, j]
                v = near[b, j]
                for c in range(C):
                    total[c] += w * widened(v[c])
            row = out[b, i]
            for c in range(C):
                row[c] = narrowed(total[c], out)


@_jit
def pool(features: Features, out: Float) -> None:
    """Maximum over points: features (B, N, C) -> out (B, C)."""
    B, N, C = features.shape
    block = min(C, 128)
    blocks = (C + block - 1) // block
    for job in numba.prange(B * blocks):
        b, first = job // blocks, job % blocks * block
        width = min(block, C - first)
        best = np.full(width, -np.inf, np.float32)
        for i in range(0, N, 2):  # two at a time; the last stands in for one beyond the end
            v0 = features[b, i, first : first + width]
            v1 = features[b, min(i + 1, N - 1), first : first + width]
            for c in range(width):
                x0, x1 = widened(v0[c]), widened(v1[c])
                x0 = x0 if x0 > x1 else x1
                best[c] = x0 if x0 > best[c] else best[c]
        out[b, first : first + width] = best


@_sums
def centre(features: Features, out: Features, squares: Float) -> None:
    """Features less their mean over the patch, (B, N, C) -> (B, N, C), and the squared lengths (B, N) of those."""
    B, N, C = features.shape
    for b in numba.prange(B):
        mean = np.zeros(C, np.float32)
        for i in range(N):
            v = features[b, i]
            for c in range(C):
                mean[c] += widened(v[c])
        for c in range(C):
            mean[c] /= np.float32(N)
        for i in range(N):
            v, row = features[b, i], out[b, i]
            for c in range(C):
                row[c] = narrowed(widened(v[c]) - mean[c], out)
            total = np.float32(0)
            for c in range(C):
                total += widened(row[c]) * widened(row[c])
            squares[b, i] = total
