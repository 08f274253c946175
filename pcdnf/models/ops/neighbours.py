"""Neighbour graphs inside patches and the reductions over them: the only place where CPU and CUDA differ.

``knn``, ``gather_max`` and ``gather_mean`` run Numba kernels on the CPU, on CUDA the first two Triton kernels where
there is Triton, and plain torch elsewhere; the plain forms (``knn_plain`` and so on) run on any device, and the
tests compare the kernels with them. All give the same graph: a point is its own first neighbour, the others follow by
distance, of equal distances the lower index first; so the graph of k neighbours is the prefix of any larger one. In
three dimensions distances come from differences, in feature space from inner products. All of it is float32, whatever
autocast says.

The kernels are compiled on first use and kept beside the package, or where it cannot be written in the user's cache
folder; ``NUMBA_CACHE_DIR`` names another place.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import torch
from torch import Tensor

from . import gather_numba, knn_numba

try:  # comes with torch's CUDA builds
    from . import triton as triton_kernels
except ImportError:
    triton_kernels = None  # type: ignore[assignment]


def knn(x: Tensor, k: int, queries: Tensor | None = None) -> Tensor:
    """Find the k nearest points, the point itself first.

    Parameters
    ----------
    x : Tensor (B, N, C)
        Points or features; no gradient flows through the choice.
    k : int
        Neighbours, 1 to N.
    queries : Tensor (B, Q), optional
        Indices of the points whose neighbours are wanted; all N by default.

    Returns
    -------
    Tensor (B, Q, k), int32
    """
    _check(x, k)
    if x.is_cuda and triton_kernels is not None:
        return triton_kernels.knn(x.detach().float(), k, queries)
    if x.device.type != "cpu" or k > knn_numba.MOST:
        return knn_plain(x, k, queries)
    B, N, C = x.shape
    with torch.no_grad(), torch.autocast("cpu", enabled=False):
        x = x.detach().float().contiguous()
        if queries is None:
            queries = torch.arange(N, dtype=torch.int32).expand(B, N)
        index = torch.empty(B, queries.shape[1], k, dtype=torch.int32)
        rows = queries.to(torch.int32).numpy()
        share_threads()
        if C == 3:
            knn_numba.select_coordinates(x.numpy(), rows, index.numpy())
        else:
            gram = _gram(x)
            squares = gram.diagonal(dim1=1, dim2=2).contiguous()
            knn_numba.select_features(gram.numpy(), squares.numpy(), rows, index.numpy())
    return index


def knn_plain(x: Tensor, k: int, queries: Tensor | None = None) -> Tensor:
    """As ``knn``, in plain torch on any device."""
    _check(x, k)
    with torch.no_grad(), torch.autocast(x.device.type, enabled=False):
        x = x.detach().float()
        if x.shape[2] == 3:
            axes = [(x[:, :, None, c] - x[:, None, :, c]).square_() for c in range(3)]
            key = axes[0].add_(axes[1]).add_(axes[2])  # (B, N, N)
        else:
            gram = _gram(x)
            key = gram.diagonal(dim1=1, dim2=2)[:, None] - 2 * gram
        key.diagonal(dim1=1, dim2=2).fill_(-torch.inf)
        if queries is not None:
            key = key.gather(1, queries.long()[..., None].expand(-1, -1, x.shape[1]))  # (B, Q, N)
        # One integer that orders by distance, then by index: topk alone leaves the order of equal keys open.
        bits = (key + 0.0).view(torch.int32).long()
        rank = torch.where(bits < 0, -(bits & 0x7FFFFFFF), bits) << 32
        rank += torch.arange(x.shape[1], device=x.device)
        return rank.topk(k, dim=-1, largest=False, sorted=True).indices.int()


def gather_max(values: Tensor, index: Tensor) -> Tensor:
    """Channel-wise maximum over neighbours, differentiable in the values.

    Parameters
    ----------
    values : Tensor (B, N, C)
    index : Tensor (B, Q, k), int32

    Returns
    -------
    Tensor (B, Q, C), float32
    """
    if values.is_cuda and triton_kernels is not None:
        return triton_kernels.GatherMax.apply(values, index)  # type: ignore[no-any-return, no-untyped-call]
    if values.device.type != "cpu":
        return gather_max_plain(values, index)
    return _GatherMax.apply(values.float(), index)  # type: ignore[no-any-return, no-untyped-call]


def gather_max_plain(values: Tensor, index: Tensor) -> Tensor:
    """As ``gather_max``, in plain torch on any device: every edge is built."""
    return _edges(values, index).amax(2)


def gather_mean(values: Tensor, index: Tensor) -> Tensor:
    """Channel-wise mean over neighbours, differentiable in the values; shapes as in ``gather_max``."""
    if values.device.type != "cpu":
        return gather_mean_plain(values, index)
    return _GatherMean.apply(values.float(), index)  # type: ignore[no-any-return, no-untyped-call]


def gather_mean_plain(values: Tensor, index: Tensor) -> Tensor:
    """As ``gather_mean``, in plain torch on any device: every edge is built."""
    return _edges(values, index).mean(2)


def gather_points(values: Tensor, index: Tensor) -> Tensor:
    """Rows of values (B, N, C) named by index (B, Q) -> (B, Q, C)."""
    return values.gather(1, index.long()[..., None].expand(-1, -1, values.shape[2]))


def _edges(values: Tensor, index: Tensor) -> Tensor:
    B, Q, k = index.shape
    return gather_points(values.float(), index.reshape(B, Q * k)).view(B, Q, k, -1)  # (B, Q, k, C)


def _gram(x: Tensor) -> Tensor:
    """Inner products (B, N, N) about the mean: what features have in common would cost the distances digits."""
    x = x - x.mean(1, keepdim=True)
    return torch.bmm(x, x.transpose(1, 2))


def _check(x: Tensor, k: int) -> None:
    if not 1 <= k <= x.shape[1]:
        raise ValueError(f"A graph of {k} neighbours needs at least {k} points; the patch has {x.shape[1]}.")


def share_threads() -> None:
    """Give the kernels as many threads as torch has."""
    threads = torch.get_num_threads()
    numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))  # type: ignore[attr-defined]
    if torch.get_num_threads() != threads:  # Numba's first launch sets OpenMP's number, which is torch's, to all cores
        torch.set_num_threads(threads)


class _GatherMax(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, values: Tensor, index: Tensor) -> Tensor:
        values, index = values.contiguous(), index.contiguous()
        out = values.new_empty(index.shape[0], index.shape[1], values.shape[2])
        share_threads()
        if ctx.needs_input_grad[0]:
            winner = torch.empty(out.shape, dtype=torch.int32)
            gather_numba.gather_argmax(_array(values), index.numpy(), out.numpy(), winner.numpy())
            ctx.save_for_backward(winner)
            ctx.points = values.shape[1]
        else:
            gather_numba.gather_max(_array(values), index.numpy(), out.numpy())
        return out

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None]:
        (winner,) = ctx.saved_tensors
        out = torch.zeros(winner.shape[0], ctx.points, winner.shape[2])
        share_threads()
        gather_numba.gather_argmax_backward(_array(grads[0].float().contiguous()), winner.numpy(), out.numpy())
        return out, None


class _GatherMean(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, values: Tensor, index: Tensor) -> Tensor:
        values, index = values.contiguous(), index.contiguous()
        out = values.new_empty(index.shape[0], index.shape[1], values.shape[2])
        share_threads()
        gather_numba.gather_mean(_array(values), index.numpy(), out.numpy())
        ctx.save_for_backward(index)
        ctx.points = values.shape[1]
        return out

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None]:
        (index,) = ctx.saved_tensors
        grad = grads[0].float().contiguous()
        out = torch.zeros(index.shape[0], ctx.points, grad.shape[2])
        share_threads()
        gather_numba.gather_mean_backward(_array(grad), index.numpy(), out.numpy())
        return out, None


def _array(x: Tensor) -> np.ndarray[Any, np.dtype[np.float32]]:
    return x.detach().numpy()
