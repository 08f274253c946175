import numpy as np
import pytest
import torch
import torch.nn.functional as F

from pcdnf.models.cpu.kernels.quadric import fit_patches, fit_points
from pcdnf.models.quadric import fit_quadric

RIDGE = np.array([1e-6, 1e-5, 1e-5, 1e-2, 1e-2, 1e-2], np.float32)


def patches(count: int, points: int) -> tuple[torch.Tensor, ...]:
    generator = torch.Generator().manual_seed(points)
    local = torch.randn(count, points, 3, generator=generator) * torch.tensor([0.5, 0.5, 0.1])
    normals = F.normalize(torch.randn(count, points, 3, generator=generator) + torch.tensor([0.0, 0.0, 2.0]), dim=-1)
    weights, slopes = torch.rand(2, count, points, generator=generator)
    return local, weights, normals, slopes


@pytest.mark.parametrize("points", [1, 7, 256])
def test_points_alone(points: int) -> None:
    local, weights, *_ = patches(4, points)
    expected = fit_quadric(local.double(), weights.double(), ridge=torch.from_numpy(RIDGE)).coefficients
    fit = np.empty(6)
    for b in range(4):
        fit_points(local[b].numpy(), weights[b].numpy(), RIDGE, fit)
        assert np.allclose(fit, expected[b], rtol=1e-3, atol=1e-5 if points > 6 else 1e-2)


@pytest.mark.parametrize("points", [1, 7, 256])
def test_with_normals_and_a_ridge_each(points: int) -> None:
    local, weights, normals, slopes = patches(4, points)
    ridge = torch.from_numpy(RIDGE) * torch.tensor([1.0, 2.0, 3.0, 4.0])[:, None]
    expected = fit_quadric(local, weights, ridge=ridge, normals=normals, slope_weights=slopes).coefficients
    fits = np.empty((4, 6), np.float32)
    fit_patches(*(x.numpy() for x in (local, weights, normals, slopes, ridge)), fits)
    assert np.allclose(fits, expected, rtol=1e-3, atol=1e-5 if points > 6 else 1e-2)


def test_recovers_a_quadric_far_beyond_float32() -> None:
    local, weights, *_ = patches(1, 64)
    x, y = local[0, :, 0], local[0, :, 1]
    coefficients = np.array([0.1, -0.2, 0.3, 0.4, -0.5, 0.6])
    local[0, :, 2] = torch.from_numpy(coefficients).float() @ torch.stack([x * 0 + 1, x, y, x * x, x * y, y * y])
    fit = np.empty(6)
    fit_points(local[0].numpy(), weights[0].numpy(), np.full(6, 1e-12, np.float32), fit)
    assert np.abs(fit - coefficients).max() < 1e-6
