"""Layers of a folded network: linear layers with BatchNorm folded in, EdgeConvs, neighbour graphs.

Everything here runs on the CPU and in inference. ``torch.ops.mkldnn`` is what torch's own compiler calls for a linear
layer with an activation. It is private to torch, and a processor may lack the instructions for a type, so
:func:`has_packed_products` tries it once a type; without it torch's public operations compute the same.
"""

from __future__ import annotations

from functools import cache
from typing import Any, TypeVar

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ..layers import SLOPE, ChannelNorm, Conv1x1, EdgeConv
from ..ops import knn_numba
from .kernels import pcdnf as pcdnf_kernels

Part = TypeVar("Part", bound=nn.Module)

TOGETHER = 2
"""Patches per batch of inner products in bfloat16; in float32 oneDNN is faster with single patches."""
PACKED_ROWS = 4096
"""Rows of the inputs that packed weights are laid out for; any number works."""


@cache
def has_packed_products(dtype: torch.dtype) -> bool:
    """Whether oneDNN multiplies with packed weights of this type here: a build, a release, a processor may not."""
    if not torch.backends.mkldnn.is_available():  # type: ignore[no-untyped-call]
        return False
    one = torch.ones(16, 16, dtype=dtype)
    try:
        product = _linear(one, torch.ops.mkldnn._reorder_linear_weight(one, PACKED_ROWS), slope=0.1)
    except (AttributeError, RuntimeError, TypeError):
        return False
    return bool((product == 16).all())


class Affine:
    """``activation(x W^T + b)`` as one product.

    Parameters
    ----------
    weight : Tensor (out, in)
    bias : Tensor (out,), optional
    dtype : torch.dtype
        Of input and output, float32 or bfloat16.
    slope : float, optional
        Of the LeakyReLU behind it; 0 is ReLU, None no activation.
    """

    def __init__(
        self,
        weight: Tensor,
        bias: Tensor | None,
        dtype: torch.dtype,
        slope: float | None = None,
    ) -> None:
        self.weight = weight.to(dtype).contiguous()
        self.bias = None if bias is None else bias.to(dtype)
        self.slope = slope
        self.packed = has_packed_products(dtype)
        if self.packed:
            self.weight = torch.ops.mkldnn._reorder_linear_weight(self.weight, PACKED_ROWS)

    def __call__(self, x: Tensor) -> Tensor:
        """Apply the layer: x (rows, in) to (rows, out)."""
        if self.packed:
            return _linear(x, self.weight, self.bias, self.slope)
        out = F.linear(x, self.weight, self.bias)
        return out if self.slope is None else F.leaky_relu_(out, self.slope)


def _linear(x: Tensor, weight: Tensor, bias: Tensor | None = None, slope: float | None = None) -> Tensor:
    name, scalars = ("none", []) if slope is None else ("leaky_relu", [slope])
    out: Tensor = torch.ops.mkldnn._linear_pointwise(x, weight, bias, name, scalars, "")
    return out


def require(part: Part | None) -> Part:
    """Return a part of a network that must exist: the ablations have no folded form."""
    assert part is not None
    return part


def scale_shift(norm: ChannelNorm) -> tuple[Tensor, Tensor]:
    """BatchNorm in inference as ``scale * x + shift``."""
    assert norm.running_mean is not None
    assert norm.running_var is not None
    scale = norm.weight / torch.sqrt(norm.running_var + norm.eps)
    return scale, norm.bias - scale * norm.running_mean


def fold_conv(conv: Conv1x1, dtype: torch.dtype) -> Affine:
    """Fold a ``Conv1x1`` into one product."""
    scale, shift = scale_shift(conv.norm)
    return Affine(scale[:, None] * conv.linear.weight, shift, dtype, conv.slope)


class Edges:
    """Folded EdgeConv: both linear layers as one product, and the scale of the gathered maximum."""

    def __init__(self, conv: EdgeConv, dtype: torch.dtype) -> None:
        scale, shift = scale_shift(conv.norm)
        weight = torch.cat([conv.neighbour.weight, scale[:, None] * conv.centre.weight])
        self.project = Affine(weight, torch.cat([torch.zeros_like(shift), shift]), dtype)
        self.scale = scale.numpy()
        self.dtype = dtype

    def __call__(self, x: Tensor, graph: Tensor) -> Tensor:
        """Convolve x (B * N, C) over a graph (B, N, k): (B, N, out)."""
        B, N, k = graph.shape
        channels = len(self.scale)
        out = torch.empty(B, N, channels, dtype=self.dtype)
        projected = as_numpy(self.project(x).view(B, N, 2 * channels))
        pcdnf_kernels.edge_conv(projected, 0, channels, graph.numpy(), k, self.scale, SLOPE, as_numpy(out), 0)
        return out


def feature_graph(x: Tensor, k: int) -> Tensor:
    """Find the nearest points in feature space: x (B, N, C) to (B, N, k), int32."""
    B, N, _ = x.shape
    centred, squares = torch.empty_like(x), np.empty((B, N), np.float32)
    pcdnf_kernels.centre(as_numpy(x), as_numpy(centred), squares)
    graph = np.empty((B, N, k), np.int32)
    together = 1 if x.dtype is torch.float32 else TOGETHER
    rows = all_queries(together, N)
    for b in range(0, B, together):
        part = slice(b, b + together)
        gram = inner_products(centred[part])  # in the caches until it is read
        knn_numba.select_features(as_numpy(gram), squares[part], rows[: len(gram)], graph[part])
    return torch.from_numpy(graph)


def inner_products(x: Tensor) -> Tensor:
    """Multiply x (B, N, C) to (B, N, N); oneDNN is faster for a single patch in float32."""
    if len(x) == 1 and x.dtype is torch.float32 and has_packed_products(x.dtype):
        return _linear(x[0], x[0])[None]
    return torch.bmm(x, x.transpose(1, 2))


def coordinate_graph(x: Tensor, k: int, queries: Tensor | None = None) -> Tensor:
    """Find the nearest points in space: x (B, N, 3) to (B, Q, k), int32."""
    B, N, _ = x.shape
    rows = all_queries(B, N) if queries is None else queries.numpy()
    graph = torch.empty(B, rows.shape[1], k, dtype=torch.int32)
    knn_numba.select_coordinates(x.numpy(), rows, graph.numpy())
    return graph


def all_queries(B: int, N: int) -> np.ndarray[Any, np.dtype[np.int32]]:
    """Every point of B patches as a query, (B, N)."""
    return np.ascontiguousarray(np.broadcast_to(np.arange(N, dtype=np.int32), (B, N)))


def pool(x: Tensor) -> Tensor:
    """Take the maximum over N: x (B, N, C) to (B, C), float32."""
    out = torch.empty(x.shape[0], x.shape[2])
    pcdnf_kernels.pool(as_numpy(x), out.numpy())
    return out


def as_numpy(x: Tensor) -> np.ndarray[Any, Any]:
    """View the memory of a tensor as an array; bfloat16 becomes uint16."""
    return (x.view(torch.uint16) if x.dtype is torch.bfloat16 else x).numpy()
