"""The other fits are what their names say."""

from __future__ import annotations

import pytest
import torch

from experiments.fits import FITS, other_fit
from pcdnf.models.quadric import fit_quadric

RIDGE = torch.full((6,), 1e-6)


def bowl(outlier: float = 0.0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    points = torch.rand(1, 200, 3, generator=generator) * 2 - 1
    points[..., 2] = 0.1 + points[..., :2].square().sum(-1)
    points[0, 1, 2] += outlier
    return points


def parts(points: torch.Tensor) -> dict[str, torch.Tensor]:
    normals = torch.zeros_like(points) + torch.tensor([0.0, 0.0, 1.0])
    return {"ridge": RIDGE, "normals": normals, "slope_weights": torch.full(points.shape[:2], 1e-6)}


@pytest.mark.parametrize("name", FITS)
def test_the_first_fit_stays(name: str) -> None:
    points = bowl()
    expected = fit_quadric(points, torch.ones(1, 200), ridge=RIDGE)
    assert torch.equal(other_fit(name)(points, torch.ones(1, 200), ridge=RIDGE).coefficients, expected.coefficients)


def test_a_plane_has_no_curvature_and_a_quadric_finds_the_bowl() -> None:
    points = bowl()
    plane = other_fit("plane")(points, torch.ones(1, 200), **parts(points))
    quadric = other_fit("as trained")(points, torch.ones(1, 200), **parts(points))
    assert plane.coefficients[0, 3:].abs().max() < 1e-3
    assert quadric.height.item() == pytest.approx(0.1, abs=1e-3)
    assert plane.height.item() > 0.5


def test_reweighting_forgets_an_outlier() -> None:
    points = bowl(outlier=30.0)
    once, usual = (other_fit(name)(points, torch.ones(1, 200), **parts(points)) for name in ("twice", "as trained"))
    assert abs(once.height.item() - 0.1) < 0.2 * abs(usual.height.item() - 0.1)
