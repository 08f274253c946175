"""Weighted quadric fit: the geometric anchor of both networks.

A patch in its PCA frame is written as a height field ``z = a + b x + c y + d x^2 + e x y + f y^2`` and fitted
by ridge-regularised weighted least squares. Value and slope of the fit at the origin (the patch's centre) give a
displacement onto the surface and a normal. The paper's Remark 1 (section 3.2.2) wants the selected points to be
co-planar; here the selector's weights receive that gradient directly. Normals, where their own weights are given,
add an equation for each slope (a Hermite fit).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

TERMS = 6
"""Coefficients of the quadric: 1, x, y, x^2, xy, y^2."""


@dataclass(frozen=True)
class QuadricFit:
    """A fitted quadric, in patch radii.

    Attributes
    ----------
    coefficients : Tensor, (B, 6) float32
        a to f; a is the height of the surface above the centre, (b, c) its slope there.
    """

    coefficients: Tensor

    @property
    def height(self) -> Tensor:
        """Height (B,) of the surface above the centre."""
        return self.coefficients[:, 0]

    @property
    def slope(self) -> Tensor:
        """dz/dx and dz/dy (B, 2) at the centre."""
        return self.coefficients[:, 1:3]

    def shifted(self, height: Tensor, slope: Tensor) -> QuadricFit:
        """Return the quadric ``height`` (B,) higher and, at the centre, steeper by ``slope`` (B, 2)."""
        change = torch.cat([height[:, None], slope, torch.zeros_like(self.coefficients[:, 3:])], -1)
        return QuadricFit(self.coefficients + change)

    def at(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Height, dz/dx and dz/dy, each (B, M), at places (B, M)."""
        a, b, c, d, e, f = self.coefficients[:, :, None].unbind(1)  # (B, 1)
        return a + x * (b + d * x + e * y) + y * (c + f * y), b + 2 * d * x + e * y, c + e * x + 2 * f * y

    def against(self, points: Tensor, weight: Tensor, normals: Tensor | None = None) -> Tensor:
        """Each neighbour against the fit (B, M, 4): height above it, its size, weight, cosine of the normals.

        ``points`` (B, M, 3), ``weight`` (B, M); without ``normals`` (B, M, 3) the last one is left out.
        """
        height, along_x, along_y = self.at(points[..., 0].float(), points[..., 1].float())  # (B, M)
        above = (points[..., 2] - height).clamp(-2, 2)
        parts = [4 * above, 4 * above.abs(), weight]
        if normals is not None:
            cosine = normals[..., 2] - normals[..., 0] * along_x - normals[..., 1] * along_y
            parts.append(cosine * torch.rsqrt(1 + along_x.square() + along_y.square()))
        return torch.stack(parts, -1)

    def _upward(self) -> tuple[Tensor, Tensor]:
        normal = torch.cat([-self.slope, torch.ones_like(self.height)[:, None]], -1)  # (B, 3)
        return normal, normal.square().sum(-1, keepdim=True)

    def displacement(self) -> Tensor:
        """Vector (B, 3) from the centre to its foot on the fit's tangent plane, in patch radii."""
        normal, square = self._upward()
        return self.height[:, None] / square * normal

    def normal(self) -> Tensor:
        """Return the unit normal (B, 3) of the fit at the centre, with z > 0."""
        normal, square = self._upward()
        return normal / square.sqrt()


def real_points(points: Tensor) -> Tensor:
    """1 for the neighbours of patches (B, M, 3), 0 for padding, which lies on the centre: (B, M) float32."""
    real = points.abs().amax(-1) > 0
    real[:, 0] = True
    return real.float()


def fit_quadric(
    points: Tensor,
    weights: Tensor,
    *,
    ridge: Tensor,
    normals: Tensor | None = None,
    slope_weights: Tensor | None = None,
) -> QuadricFit:
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
    normals : Tensor, (B, M, 3), optional
        Unit normals, z >= 0; with ``slope_weights`` each asks the fit for its slope.
    slope_weights : Tensor, (B, M), optional
        Weight of a normal's equations relative to its point's.

    Returns
    -------
    QuadricFit
        float32, differentiable in every argument.
    """
    with torch.autocast(points.device.type, enabled=False):
        x, y, z = points.float().unbind(-1)  # (B, M)
        one = torch.ones_like(x)
        design = torch.stack([one, x, y, x * x, x * y, y * y], -1)  # (B, M, 6)
        weights = weights.float()
        weights = weights / weights.sum(1, keepdim=True)
        weighted = design * weights[..., None]  # (B, M, 6)
        gram = weighted.transpose(1, 2) @ design  # (B, 6, 6)
        right = (z[:, None] @ weighted)[:, 0]  # (B, 6)
        if normals is not None and slope_weights is not None:
            u, v, w = normals.float().unbind(-1)  # (B, M)
            zero = torch.zeros_like(x)
            along = torch.cat(
                [
                    torch.stack([zero, one, zero, 2 * x, y, zero], -1),
                    torch.stack([zero, zero, one, zero, x, 2 * y], -1),
                ],
                1,
            )  # (B, 2 M, 6)
            share = weights * slope_weights.float() * w  # (B, M)
            right = right - (torch.cat([share * u, share * v], 1)[:, None] @ along)[:, 0]
            gram = gram + (along * torch.cat([share * w, share * w], 1)[..., None]).transpose(1, 2) @ along
        gram = gram + torch.diag_embed(ridge.float().expand(len(x), TERMS))
        factor, _ = torch.linalg.cholesky_ex(gram.double())
        return QuadricFit(torch.cholesky_solve(right[..., None].double(), factor)[..., 0].float())
