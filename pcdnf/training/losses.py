"""Training losses (paper, section 3.3), in the patch frame, in patch radii."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional as F

ANGLE = math.radians(15)
"""theta's angle: normals farther apart than this are taken to be of another surface."""
SUPPORT = 0.08
"""phi's support: the spacing of 500 points in a ball of radius 1."""
COPLANAR = 0.05
"""Height above the centre's clean tangent plane, in patch radii, at which a neighbour counts e times less."""


@dataclass(frozen=True, kw_only=True)
class LossWeights:
    """Weight of each term; the defaults are the paper's (section 3.3), the last four are ours.

    Attributes
    ----------
    point, normal, ortho : float
        lambda_1, lambda_2, lambda_3.
    alpha : float
        Share of the projection term in the point loss; the rest is repulsion.
    nearest : float
        Distance to the nearest clean point: keeps points from sliding along the surface.
    dense_point, dense_normal : float
        Supervision of the refined points and normals of the whole patch.
    coplanar : float
        Cross entropy of the selector's weights against true co-planarity.
    """

    point: float = 100.0
    normal: float = 10.0
    ortho: float = 10.0
    alpha: float = 0.97
    nearest: float = 0.0
    dense_point: float = 50.0
    dense_normal: float = 5.0
    coplanar: float = 0.0


@dataclass(frozen=True)
class Surface:
    """Clean surface around each patch's centre: ``points`` and ``normals``, (B, S, 3)."""

    points: Tensor
    normals: Tensor


@dataclass(frozen=True)
class PointTerms:
    """What the point loss is made of, each (B,), and the clean normal nearest to the denoised point (B, 3)."""

    projection: Tensor
    repulsion: Tensor
    nearest: Tensor
    normal: Tensor


def point_terms(displacement: Tensor, surface: Surface) -> PointTerms:
    """Bilateral projection distance of the denoised points (B, 3) to the clean surface (L_point)."""
    offset = displacement[:, None] - surface.points  # (B, S, 3)
    square = offset.square().sum(-1)  # (B, S)
    least, at = square.min(1)
    normal = surface.normals[torch.arange(len(at), device=at.device), at]  # (B, 3)
    theta = torch.exp(-(1 - (normal[:, None] * surface.normals).sum(-1)) / (1 - math.cos(ANGLE)))
    support = least.detach().sqrt().clamp(min=SUPPORT)[:, None]  # a gradient also when far away
    weight = torch.exp(-square / support.square()) * theta + 1e-12
    project = (offset * surface.normals).sum(-1).abs()
    projection = (project * weight).sum(1) / weight.sum(1)
    return PointTerms(projection, square.amax(1), (least + 1e-12).sqrt(), normal)


def normal_loss(predicted: Tensor, normal: Tensor) -> Tensor:
    """Squared distance up to sign (L_normal), (..., 3) to (...), at most 2 for unit vectors."""
    return torch.minimum((predicted - normal).square().sum(-1), (predicted + normal).square().sum(-1))


def ortho_loss(displacement: Tensor, predicted: Tensor, weight: Tensor, clean: Tensor) -> Tensor:
    """Orthogonality of normal and patch (L_ortho), normalised by the weights: (B,).

    ``weight`` (B, M) belongs to noisy points; ``clean`` (B, M, 3) are their clean counterparts.
    """
    height = ((displacement[:, None] - clean) * F.normalize(predicted, dim=-1)[:, None]).sum(-1)  # (B, M)
    return (weight * height).square().sum(1) / weight.square().sum(1).clamp(min=1e-6)


def coplanar_loss(weight: Tensor, surface: Surface, clean: Tensor, clean_normals: Tensor) -> Tensor:
    """Cross entropy of the weights (B, M) against true co-planarity: () of all patches.

    A neighbour is co-planar as far as its clean counterpart (``clean``, ``clean_normals``, (B, M, 3)) lies on the
    tangent plane at the clean point nearest to the centre and its normal is that plane's.
    """
    nearest = surface.points.square().sum(-1).argmin(1)
    rows = torch.arange(len(nearest), device=nearest.device)
    foot, normal = surface.points[rows, nearest], surface.normals[rows, nearest]  # (B, 3)
    height = ((clean - foot[:, None]) * normal[:, None]).sum(-1)  # (B, M)
    along = (clean_normals * normal[:, None]).sum(-1)
    target = (torch.exp(-(height / COPLANAR).square()) * along.square()).clamp(max=1)
    return F.binary_cross_entropy(weight.clamp(1e-5, 1 - 1e-5), target)


@dataclass(frozen=True)
class Batch:
    """Patches with their supervision; all tensors float32 in the patch frames.

    Attributes
    ----------
    points, normals : Tensor, (B, M, 3)
    surface : Surface
        (B, S, 3), clean.
    clean_points, clean_normals : Tensor, (B, M, 3)
        Counterparts of the patch's points.
    """

    points: Tensor
    normals: Tensor
    surface: Surface
    clean_points: Tensor
    clean_normals: Tensor

    def each(self, change: Callable[[Tensor], Tensor]) -> Batch:
        """Return the batch with the same change to every tensor, such as a move to a device."""
        surface = Surface(change(self.surface.points), change(self.surface.normals))
        clean = change(self.clean_points), change(self.clean_normals)
        return Batch(change(self.points), change(self.normals), surface, *clean)

    def pin_memory(self) -> Batch:
        """In memory that a GPU reads by itself."""
        return self.each(Tensor.pin_memory)


def joint_loss(output: Any, batch: Batch, weights: LossWeights) -> tuple[Tensor, dict[str, Tensor]]:
    """Return the joint loss (section 3.3, and our terms) of a batch, with its parts."""
    terms = point_terms(output.displacement, batch.surface)
    point = weights.alpha * terms.projection + (1 - weights.alpha) * terms.repulsion
    normal = normal_loss(output.normal, terms.normal)
    loss = weights.point * point.mean() + weights.normal * normal.clamp(max=2).mean()
    loss = loss + weights.nearest * terms.nearest.mean()
    if weights.ortho:
        ortho = ortho_loss(output.displacement, output.normal, output.weight, batch.clean_points)
        loss = loss + weights.ortho * ortho.mean()
    if weights.coplanar:
        coplanar = coplanar_loss(output.weight, batch.surface, batch.clean_points, batch.clean_normals)
        loss = loss + weights.coplanar * coplanar
    if weights.dense_point or weights.dense_normal:
        offset = output.refined_points - batch.clean_points  # (B, M, 3)
        dense = (offset * batch.clean_normals).sum(-1).abs() + 0.02 * offset.square().sum(-1).add(1e-12).sqrt()
        turned = F.normalize(output.refined_normals, dim=-1)
        loss = loss + weights.dense_point * dense.mean()
        loss = loss + weights.dense_normal * normal_loss(turned, batch.clean_normals).mean()
    watched = {
        "loss": loss,
        "point": terms.projection.mean(),
        "nearest": terms.nearest.mean(),
        "angle": angle_degrees(output.normal, terms.normal).mean(),
    }
    return loss, {key: value.detach() for key, value in watched.items()}


def angle_degrees(predicted: Tensor, normal: Tensor) -> Tensor:
    """Angle between directions (..., 3), up to sign, in degrees."""
    cosine = (F.normalize(predicted, dim=-1) * normal).sum(-1).abs().clamp(max=1)
    return torch.rad2deg(torch.acos(cosine))
