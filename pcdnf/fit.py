"""Weighted quadric fit: the geometric anchor of both networks.

A patch in its PCA frame is written as a height field ``z = a + b x + c y + d x^2 + e x y + f y^2`` and fitted
by ridge-regularised weighted least squares. Value and slope of the fit at the origin (the patch's centre) give a
displacement onto the surface and a normal. The paper's Remark 1 (section 3.2.2) wants the selected points to be
co-planar; here the selector's weights receive that gradient directly.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

TERMS = 6
"""Coefficients of the quadric: 1, x, y, x^2, xy, y^2."""


@dataclass(frozen=True)
class QuadricFit:
    """Height and slope of a fitted quadric at the centre of its patch.

    Attributes
    ----------
    height : Tensor, (B,) float32
        z of the surface above the centre, in patch radii.
    slope : Tensor, (B, 2) float32
        dz/dx and dz/dy at the centre.
    """

    height: Tensor
    slope: Tensor

    def _upward(self) -> tuple[Tensor, Tensor]:
        normal = torch.cat([-self.slope, torch.ones_like(self.height)[:, None]], -1)  # (B, 3)
        return normal, normal.square().sum(-1, keepdim=True)

    def displacement(self) -> Tensor:
        """Vector (B, 3) from the centre to its foot on the fit's tangent plane, in patch radii."""
        normal, square = self._upward()
        return self.height[:, None] / square * normal

    def normal(self) -> Tensor:
        """Unit normal (B, 3) of the fit at the centre, with z > 0."""
        normal, square = self._upward()
        return normal / square.sqrt()


def fit_quadric(points: Tensor, weights: Tensor, *, ridge: Tensor) -> QuadricFit:
    """Fit a height field to each patch.

    Parameters
    ----------
    points : Tensor, (B, M, 3)
        Points in the patch's PCA frame, in patch radii, centre at the origin.
    weights : Tensor, (B, M)
        Non-negative weights, with a positive sum for each patch.
    ridge : Tensor, (6,) or (B, 6)
        Positive ridge a coefficient, relative to the mean weight. It keeps the system regular even for a patch
        with a single point.

    Returns
    -------
    QuadricFit
        float32, differentiable in ``points``, ``weights`` and ``ridge``.
    """
    with torch.autocast(points.device.type, enabled=False):
        x, y, z = points.float().unbind(-1)  # (B, M)
        design = torch.stack([torch.ones_like(x), x, y, x * x, x * y, y * y], -1)  # (B, M, 6)
        weights = weights.float()
        weighted = design * (weights / weights.sum(1, keepdim=True))[..., None]  # (B, M, 6)
        gram = design.transpose(1, 2) @ weighted  # (B, 6, 6)
        gram = gram + torch.diag_embed(ridge.float().expand(len(x), TERMS))
        right = (weighted * z[..., None]).sum(1)  # (B, 6)
        factor, _ = torch.linalg.cholesky_ex(gram)
        solution = torch.cholesky_solve(right[..., None], factor)[..., 0]  # (B, 6)
        return QuadricFit(solution[:, 0], solution[:, 1:3])
