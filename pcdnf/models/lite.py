"""The light network: a selector, and a weighted quadric fit as decoder.

It keeps the paper's idea (a shape-aware selector, section 3.2.2, decides which neighbours share the centre's
surface; points and normals are solved jointly) and leaves the rest to least squares. A first score of each neighbour
gives a first fit (:func:`.quadric.fit_quadric`). Each neighbour's height above that fit, and the angle between the
normals, give the final score and a second score: how far the neighbour's normal may steer the slope. The pooled
context adds small corrections. The network has 44 thousand parameters.

The inputs are a patch's points and initial normals (B, M, 3) in its PCA frame, in patch radii, the centre first; a
point at the origin other than the first is padding. M is free; the training used 96 to 256.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from .quadric import QuadricFit, fit_quadric, real_points

RIDGE = (1e-6, 1e-5, 1e-5, 1e-2, 1e-2, 1e-2)
"""Ridge of the six coefficients, before the network scales it."""
SLOPE = 0.2
"""Of every LeakyReLU, as in the paper's network."""
LEAST = 1e-6
"""Least weight of a neighbour."""
STEER = 3.0
"""Subtracted from the score of a normal's weight: at the start of a training, normals steer the slope little."""


@dataclass(frozen=True)
class LiteConfig:
    """Size of the light network: ``width`` channels a neighbour."""

    width: int = 64


@dataclass(frozen=True)
class LiteOutput:
    """Prediction of the light network for a patch's centre.

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

    ridge: Tensor

    def __init__(self, config: LiteConfig = LiteConfig()) -> None:
        super().__init__()
        self.config = config
        width = config.width
        self.embed = nn.Sequential(nn.Linear(11, width), nn.LeakyReLU(SLOPE), nn.Linear(width, width))
        self.embed_norm = nn.LayerNorm(width)
        self.block = ContextBlock(width, width)
        self.block_norm = nn.LayerNorm(width)
        self.first_score = nn.Linear(width, 1)
        self.residual = nn.Linear(4, width)
        self.score = ContextBlock(width, 2)
        last = nn.Linear(width, 9)
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
        self.correct = nn.Sequential(nn.Linear(2 * width, width), nn.LeakyReLU(SLOPE), last)
        self.register_buffer("ridge", torch.tensor(RIDGE), persistent=False)

    def forward(self, points: Tensor, normals: Tensor) -> LiteOutput:
        """Points and initial normals (B, M, 3) of patches to displacement, normal and weights."""
        mask = real_points(points)[..., None]  # (B, M, 1)
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
        weight = _weight(self.first_score(features)[..., 0], mask)  # (B, M)
        first = fit_quadric(points, weight, ridge=self.ridge)
        features = features + self.residual(first.against(points, weight, normals))
        context = _pool(features, mask)  # (B, 2 width)
        score, steer = self.score(features, context).float().unbind(-1)  # (B, M)
        weight = _weight(score, mask)
        corrections = self.correct(context).float()  # (B, 9)
        fit = fit_quadric(
            points,
            weight,
            ridge=scaled_ridge(self.ridge, corrections),
            normals=normals,
            slope_weights=torch.sigmoid(steer - STEER) * mask[..., 0],
        )
        return corrected(fit, corrections, weight)


def scaled_ridge(ridge: Tensor, corrections: Tensor) -> Tensor:
    """Ridge (6,) of each patch (B, 6), its slope and curvatures scaled by the network's corrections (B, 9)."""
    scale = corrections[:, :4].clamp(-8, 8).exp()  # (B, 4): of the slope and of the three curvatures
    return ridge * torch.cat([torch.ones_like(scale[:, :1]), scale[:, :1], scale], -1) + 1e-6


def corrected(fit: QuadricFit, corrections: Tensor, weight: Tensor) -> LiteOutput:
    """Move and turn the last fit by the network's corrections (B, 9); ``weight`` (B, M) are its weights."""
    fit = fit.shifted(0.1 * corrections[:, 4], 0.3 * corrections[:, 5:7])
    displacement = fit.displacement() + 0.1 * F.pad(corrections[:, 7:], (0, 1))  # (B, 3)
    return LiteOutput(displacement, fit.normal(), weight)


def _weight(score: Tensor, mask: Tensor) -> Tensor:
    """Scores (B, M) and mask (B, M, 1) to weights (B, M) float32, positive where the mask is."""
    return (torch.sigmoid(score.float()) + LEAST) * mask[..., 0]


def _pool(features: Tensor, mask: Tensor) -> Tensor:
    """Maximum and mean over the valid neighbours: (B, M, C) and (B, M, 1) to (B, 2 C)."""
    mask = mask.to(features.dtype)
    highest = (features - 1e4 * (1 - mask)).amax(1)
    return torch.cat([highest, (features * mask).sum(1) / mask.sum(1)], -1)
