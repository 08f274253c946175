"""The geometric anchor: the weighted quadric fit that both networks correct."""

from __future__ import annotations

from torch import Tensor

from .quadric import QuadricFit, fit_quadric, real_points

ANCHOR_REACH = 0.3  # largest correction of the anchor's displacement, in patch radii


ANCHOR_RIDGE = (1e-6, 1e-5, 1e-5, 1e-2, 1e-2, 1e-2)  # on 1, x, y, x^2, xy, y^2


ANCHOR_FLOOR = 1e-4  # added to every weight of the fit


STEER = -3.0  # the slopes' score starts low: normals are noisier than points


def anchor(points: Tensor, weight: Tensor, normals: Tensor | None = None, steer: Tensor | None = None) -> QuadricFit:
    """The fit that the decoders correct: points, normals (B, M, 3), weight, steer (B, M); padding has no say."""
    weight = (weight + ANCHOR_FLOOR) * real_points(points)
    ridge = points.new_tensor(ANCHOR_RIDGE)
    return fit_quadric(points, weight, ridge=ridge, normals=normals, slope_weights=steer)
