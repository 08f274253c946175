"""The geometric anchor: the weighted quadric fit that both networks correct."""

from __future__ import annotations

from torch import Tensor

from .quadric import QuadricFit, fit_quadric, real_points

ANCHOR_REACH = 0.3
"""Largest correction of the anchor's displacement, in patch radii."""
ANCHOR_RIDGE = (1e-6, 1e-5, 1e-5, 1e-2, 1e-2, 1e-2)
"""Ridge on the coefficients of 1, x, y, x^2, xy, y^2."""
ANCHOR_FLOOR = 1e-4
"""Added to every weight of the fit."""
STEER = -3.0
"""Start of the slopes' score, low because normals are noisier than points."""


def anchor(points: Tensor, weight: Tensor, normals: Tensor | None = None, steer: Tensor | None = None) -> QuadricFit:
    """Fit the quadric that the decoders correct.

    Parameters
    ----------
    points : Tensor, (B, M, 3) float32
        In the patch frame, in patch radii; padding lies at the origin and has no weight.
    weight : Tensor, (B, M) float32
        Similarity to the centre, 0 to 1.
    normals : Tensor, (B, M, 3) float32, optional
    steer : Tensor, (B, M) float32, optional
        Weight of each normal in the fit, relative to its point's.

    Returns
    -------
    QuadricFit
    """
    weight = (weight + ANCHOR_FLOOR) * real_points(points)
    ridge = points.new_tensor(ANCHOR_RIDGE)
    return fit_quadric(points, weight, ridge=ridge, normals=normals, slope_weights=steer)
