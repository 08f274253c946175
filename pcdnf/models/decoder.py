"""Decoder of the paper's network (section 3.2.4): displacement and normal of a patch's centre from fused features."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import torch
from torch import Tensor, nn

from .layers import Conv1x1, EdgeConv
from .ops.neighbours import knn

if TYPE_CHECKING:
    from .config import NetworkConfig

REGRESSOR_NEIGHBOURS = 8  # of the two EdgeConvs in the normal regressor


class FusedFeatures(NamedTuple):
    """Input of the decoder: features of the selected points and, for the point branch, of the patch."""

    point: Tensor | None  # (B, K, 256), 128 without one of the branches or without refinement
    patch: Tensor | None  # (B, 128); the third part of the point branch's concatenation, the same for all K
    normal: Tensor | None  # (B, K, 256), or 128 likewise; the patch's part is already added


class CoordinateRegressor(nn.Module):
    """Displacement of the centre from the refined point features."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        fused = config.refinement
        self.conv = Conv1x1(256 if fused and config.normal_branch else 128, 512, shared=128 if fused else 0)
        self.reduce = nn.Sequential(Conv1x1(512, 256, slope=0.0), Conv1x1(256, 64, slope=0.0))  # ReLU
        self.out = nn.Linear(64, 3)

    def forward(self, f: Tensor, patch: Tensor | None) -> Tensor:
        """Point features f (B, K, C) and patch features (B, 128) to displacements (B, 3), in patch radii."""
        f = self.conv(f, patch).amax(1)  # (B, 512)
        return torch.tanh(self.out(self.reduce(f)).float())  # (B, 3)


class NormalRegressor(nn.Module):
    """Filtered normal of the centre from the refined normal features."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.conv = Conv1x1(256 if config.refinement and config.point_branch else 128, 128)
        self.squeeze = EdgeConv(128, 64)
        self.expand = EdgeConv(64, 128)
        self.lift = Conv1x1(128, 256)
        self.reduce = nn.Sequential(Conv1x1(256, 128), Conv1x1(128, 64))
        self.out = nn.Linear(64, 3)

    def forward(self, f: Tensor) -> Tensor:
        """Decode normal features f (B, K, C) to normals (B, 3), not normalised."""
        f = self.conv(f)  # (B, K, 128)
        g = self.squeeze(f, knn(f, REGRESSOR_NEIGHBOURS))  # (B, K, 64)
        g = self.expand(g, knn(g, REGRESSOR_NEIGHBOURS))  # (B, K, 128)
        f = self.lift(f + g).amax(1)  # (B, 256)
        out: Tensor = self.out(self.reduce(f)).float()  # (B, 3)
        return out


class Decoder(nn.Module):
    """Coordinate and normal regressor."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.coordinate = CoordinateRegressor(config) if config.point_branch else None
        self.normal = NormalRegressor(config) if config.normal_branch else None
        if config.anchor:  # start from the fit
            for regressor in (self.coordinate, self.normal):
                if regressor is not None:
                    nn.init.normal_(regressor.out.weight, std=1e-3)
                    nn.init.zeros_(regressor.out.bias)

    def forward(self, fused: FusedFeatures) -> tuple[Tensor | None, Tensor | None]:
        """Fused features to displacement and normal (B, 3); None for a branch that is switched off."""
        displacement = normal = None
        if self.coordinate is not None and fused.point is not None:
            displacement = self.coordinate(fused.point, fused.patch)
        if self.normal is not None and fused.normal is not None:
            normal = self.normal(fused.normal)
        return displacement, normal
