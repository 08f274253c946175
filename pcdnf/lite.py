"""The light network: a selector alone, and a weighted quadric fit as decoder.

It keeps the paper's idea (a shape-aware selector, section 3.2.2, decides which neighbours share the centre's
surface; points and normals are solved jointly) and leaves the rest to least squares: weights in (0, 1) for 128
neighbours feed :func:`pcdnf.fit.fit_quadric`, and the pooled context adds small corrections. 43 thousand parameters.

Input are a patch's points and raw normals (B, M, 3) in its PCA frame, in patch radii, the centre first; a point
at the origin other than the first is padding.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from .fit import fit_quadric

RIDGE = (1e-6, 1e-5, 1e-5, 1e-2, 1e-2, 1e-2)
"""Ridge of the six coefficients, before the network scales it."""
SLOPE = 0.2
"""Of every LeakyReLU, as in the paper's network."""


@dataclass(frozen=True)
class LiteConfig:
    """Size of the light network: ``width`` channels a neighbour."""

    width: int = 64


@dataclass(frozen=True)
class LiteOutput:
    """What the light network says of a patch's centre.

    Attributes
    ----------
    displacement : Tensor, (B, 3) float32
        In patch radii, in the patch frame.
    normal : Tensor, (B, 3) float32
        Unit length, z > 0 in the patch frame.
    weight : Tensor, (B, M) float32
        Selector's weight of each neighbour, 0 for padding.
    """

    displacement: Tensor
    normal: Tensor
    weight: Tensor

    @property
    def selected(self) -> Tensor:
        """Indices (B, M // 2) int64 of the neighbours of greatest weight."""
        return self.weight.topk(self.weight.shape[1] // 2, dim=-1).indices


class ContextBlock(nn.Module):
    """Residual block whose hidden layer also sees the patch: maximum and mean over its neighbours."""

    def __init__(self, width: int, out: int) -> None:
        super().__init__()
        self.own = nn.Linear(width, width)
        self.context = nn.Linear(2 * width, width)
        self.out = nn.Linear(width, out)

    def forward(self, features: Tensor, context: Tensor) -> Tensor:
        """Features (B, M, width) and context (B, 2 width) to (B, M, out)."""
        hidden = self.own(features) + self.context(context)[:, None]  # (B, M, width)
        out: Tensor = self.out(F.leaky_relu(hidden, SLOPE))
        return out


class PCDNFLite(nn.Module):
    """The light network; see the module's docstring."""

    def __init__(self, config: LiteConfig = LiteConfig()) -> None:
        super().__init__()
        self.config = config
        width = config.width
        self.embed = nn.Sequential(nn.Linear(11, width), nn.LeakyReLU(SLOPE), nn.Linear(width, width))
        self.embed_norm = nn.LayerNorm(width)
        self.block = ContextBlock(width, width)
        self.block_norm = nn.LayerNorm(width)
        self.score = ContextBlock(width, 1)
        last = nn.Linear(width, 6)
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
        self.correct = nn.Sequential(nn.Linear(2 * width, width), nn.LeakyReLU(SLOPE), last)
        self.register_buffer("ridge", torch.tensor(RIDGE), persistent=False)

    def forward(self, points: Tensor, normals: Tensor) -> LiteOutput:
        """Points and raw normals (B, M, 3) of patches to displacement, normal and weights."""
        valid = points.abs().amax(-1, keepdim=True) > 0  # (B, M, 1)
        valid[:, 0] = True
        mask = valid.to(points.dtype)
        features = torch.cat(
            [
                points,
                points.norm(dim=-1, keepdim=True),
                normals,
                (points * normals).sum(-1, keepdim=True),
                normals[:, :1].expand_as(normals),
            ],
            -1,
        )  # (B, M, 11)
        features = F.leaky_relu(self.embed_norm(self.embed(features)), SLOPE)  # (B, M, width)
        features = features + self.block(features, _pool(features, mask))
        features = F.leaky_relu(self.block_norm(features), SLOPE)
        context = _pool(features, mask)  # (B, 2 width)
        score = self.score(features, context)  # (B, M, 1)
        weight = (torch.sigmoid(score.float()) * mask)[..., 0]  # (B, M)
        ridge, height, slope, slide = self.correct(context).float().split([1, 1, 2, 2], -1)
        fit = fit_quadric(points, weight + 1e-6 * mask[..., 0], ridge=self.ridge * ridge.clamp(-8, 8).exp() + 1e-6)
        fit = type(fit)(fit.height + 0.1 * height[:, 0], fit.slope + 0.3 * slope)
        displacement = fit.displacement() + 0.1 * F.pad(slide, (0, 1))  # (B, 3)
        return LiteOutput(displacement, fit.normal(), weight)


def _pool(features: Tensor, mask: Tensor) -> Tensor:
    """Maximum and mean over the valid neighbours: (B, M, C) and (B, M, 1) to (B, 2 C)."""
    mask = mask.to(features.dtype)
    highest = (features - 1e4 * (1 - mask)).amax(1)
    return torch.cat([highest, (features * mask).sum(1) / mask.sum(1)], -1)
