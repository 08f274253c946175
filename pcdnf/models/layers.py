"""Layers of the paper's network: over the points of a patch, and EdgeConv (DGCNN) without building its edges.

With ``W [x_j - x_i ; x_i] = W1 x_j + (W2 - W1) x_i`` an EdgeConv is two linear layers on the points and one gather-max;
``neighbour`` is W1, ``centre`` is W2 - W1. BatchNorm and LeakyReLU follow the maximum. In inference that equals
the usual order if the BatchNorm scale is positive; ``authors_weights`` flips the signs of the other channels. In
training the batch statistics are those of the maxima, not of all edges.
"""

from __future__ import annotations

import torch.nn.functional as F
from torch import Tensor, nn

from .ops.neighbours import gather_max

SLOPE = 0.2  # of every LeakyReLU


class ChannelNorm(nn.BatchNorm1d):
    """BatchNorm over the last axis, in float32."""

    def forward(self, input: Tensor) -> Tensor:
        """Normalise the channels of (..., C)."""
        return super().forward(input.float().reshape(-1, input.shape[-1])).view(input.shape)


class Conv1x1(nn.Module):
    """Linear layer, BatchNorm, LeakyReLU; ``shared`` channels are the same for all points of a patch."""

    def __init__(self, channels: int, out: int, *, shared: int = 0, slope: float = SLOPE) -> None:
        super().__init__()
        self.linear = nn.Linear(channels, out, bias=False)
        self.shared = nn.Linear(shared, out, bias=False) if shared else None
        self.norm = ChannelNorm(out)
        self.slope = slope

    def forward(self, x: Tensor, shared: Tensor | None = None) -> Tensor:
        """Features x (B, N, channels) and shared ones (B, shared) to (B, N, out)."""
        y = self.linear(x)  # (B, N, out)
        if self.shared is not None and shared is not None:
            y = y + self.shared(shared)[:, None]
        return F.leaky_relu(self.norm(y), self.slope)


class EdgeConv(nn.Module):
    """max over neighbours j of LeakyReLU(BN(W [x_j - x_i ; x_i])), without the edges."""

    def __init__(self, channels: int, out: int) -> None:
        super().__init__()
        self.neighbour = nn.Linear(channels, out, bias=False)
        self.centre = nn.Linear(channels, out, bias=False)
        self.norm = ChannelNorm(out)

    def forward(self, x: Tensor, graph: Tensor) -> Tensor:
        """Features x (B, N, channels) over a graph (B, N, k) int32 to (B, N, out)."""
        y = self.centre(x) + gather_max(self.neighbour(x), graph)  # (B, N, out)
        return F.leaky_relu(self.norm(y), SLOPE)
