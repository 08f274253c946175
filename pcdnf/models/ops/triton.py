"""The kernels of ``pcdnf.models.ops.neighbours`` for CUDA, in Triton, which comes with torch's CUDA builds.

Neighbour graphs never leave the chip as a distance matrix: a program takes some queries of one patch, forms their
distances to all points block by block and picks the nearest one after the other. A gathered maximum remembers its
winners, so that its backward pass is a scatter of the output's size instead of one over all edges.
"""

# mypy: ignore-errors
from __future__ import annotations

from typing import Any

import torch
import triton
import triton.language as tl
from torch import Tensor

QUERIES = 16
"""Queries a program takes at a time."""


def knn(x: Tensor, k: int, queries: Tensor | None) -> Tensor:
    """See :func:`pcdnf.models.ops.neighbours.knn`: x (B, N, C) float32, queries (B, Q) -> (B, Q, k) int32."""
    B, N, C = x.shape
    if queries is None:
        queries = torch.arange(N, device=x.device).expand(B, N)
    queries = queries.to(torch.int32).contiguous()
    if C > 3:
        x = x - x.mean(1, keepdim=True)  # what features have in common would cost the distances digits
    x = x.contiguous()
    Q = queries.shape[1]
    index = torch.empty(B, Q, k, dtype=torch.int32, device=x.device)
    wide = max(16, triton.next_power_of_2(N))
    chunk = 4 if C == 3 else min(32, triton.next_power_of_2(C))
    _knn[(B, triton.cdiv(Q, QUERIES))](
        x,
        x.square().sum(-1),
        queries,
        index,
        N,
        Q,
        C,
        k,
        NEAR=wide,
        ROWS=QUERIES,
        CHUNK=chunk,
        SPACE=C == 3,
        num_warps=4,
    )
    return index


class GatherMax(torch.autograd.Function):
    """See :func:`.neighbours.gather_max`: values (B, N, C), index (B, Q, k) int32 -> (B, Q, C) float32."""

    @staticmethod
    def forward(ctx: Any, values: Tensor, index: Tensor) -> Tensor:
        """Gather the maxima and remember which neighbour each came from."""
        values, index = values.contiguous(), index.contiguous()
        (B, N, C), (_, Q, k) = values.shape, index.shape
        out = torch.empty(B, Q, C, device=values.device)
        winner = torch.empty(B, Q, C, dtype=torch.int32, device=values.device)
        grid = (B, triton.cdiv(Q, QUERIES))
        _gather_max[grid](values, index, out, winner, N, Q, k, C, ROWS=QUERIES, WIDE=triton.next_power_of_2(C))
        ctx.save_for_backward(winner)
        ctx.points, ctx.dtype = N, values.dtype
        return out

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None]:
        """Scatter the gradient to the neighbours that the maxima came from."""
        (winner,) = ctx.saved_tensors
        grad = torch.zeros(len(winner), ctx.points, winner.shape[2], device=winner.device)
        return grad.scatter_add_(1, winner.long(), grads[0].float()).to(ctx.dtype), None


@triton.jit
def _knn(
    x,
    squares,
    queries,
    index,
    N,
    Q,
    C,
    k,
    NEAR: tl.constexpr,
    ROWS: tl.constexpr,
    CHUNK: tl.constexpr,
    SPACE: tl.constexpr,
):
    patch = tl.program_id(0).to(tl.int64)
    rows = tl.program_id(1) * ROWS + tl.arange(0, ROWS)
    inside = rows < Q
    own = tl.load(queries + patch * Q + rows, mask=inside, other=0)
    near = tl.arange(0, NEAR)
    points = x + patch * N * C
    if SPACE:
        key = tl.zeros((ROWS, NEAR), tl.float32)
        for c in range(3):
            a = tl.load(points + own * 3 + c)
            b = tl.load(points + near * 3 + c, mask=near < N, other=0.0)
            step = a[:, None] - b[None, :]
            key += step * step
    else:
        inner = tl.zeros((ROWS, NEAR), tl.float32)
        for start in range(0, C, CHUNK):
            c = start + tl.arange(0, CHUNK)
            a = tl.load(points + own[:, None] * C + c[None, :], mask=c[None, :] < C, other=0.0)
            b = tl.load(points + near[None, :] * C + c[:, None], mask=(near[None, :] < N) & (c[:, None] < C), other=0.0)
            inner += tl.dot(a, b, input_precision="ieee")
        key = tl.load(squares + patch * N + near, mask=near < N, other=0.0)[None, :] - 2 * inner
    key = tl.where(near[None, :] < N, key, float("inf"))
    key = tl.where(near[None, :] == own[:, None], -float("inf"), key)
    for i in range(k):
        best = tl.argmin(key, 1, tie_break_left=True)
        tl.store(index + (patch * Q + rows) * k + i, best, mask=inside)
        key = tl.where(near[None, :] == best[:, None], float("inf"), key)


@triton.jit
def _gather_max(values, index, out, winner, N, Q, k, C, ROWS: tl.constexpr, WIDE: tl.constexpr):
    patch = tl.program_id(0).to(tl.int64)
    rows = tl.program_id(1) * ROWS + tl.arange(0, ROWS)
    inside = rows < Q
    channels = tl.arange(0, WIDE)
    mask = inside[:, None] & (channels[None, :] < C)
    best = tl.full((ROWS, WIDE), -float("inf"), tl.float32)
    which = tl.zeros((ROWS, WIDE), tl.int32)
    for t in range(k):
        near = tl.load(index + (patch * Q + rows) * k + t, mask=inside, other=0)
        value = tl.load(values + (patch * N + near[:, None]) * C + channels[None, :], mask=mask, other=0.0)
        more = value.to(tl.float32) > best
        best = tl.where(more, value.to(tl.float32), best)
        which = tl.where(more, near[:, None], which)
    at = (patch * Q + rows[:, None]) * C + channels[None, :]
    tl.store(out + at, best, mask=mask)
    tl.store(winner + at, which, mask=mask)
