import torch

from pcdnf.models.quadric import fit_quadric

RIDGE = torch.full((6,), 1e-9)


def patch(count: int = 200, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    xy = torch.rand(1, count, 2, generator=generator) * 2 - 1
    x, y = xy.unbind(-1)
    z = 0.05 + 0.2 * x - 0.1 * y + 0.3 * x * x - 0.2 * x * y + 0.1 * y * y
    return torch.cat([xy, z[..., None]], -1)


def test_height_and_slope_of_a_quadric_are_exact() -> None:
    fit = fit_quadric(patch(), torch.ones(1, 200), ridge=RIDGE)
    assert torch.allclose(fit.height, torch.tensor([0.05]), atol=1e-4)
    assert torch.allclose(fit.slope, torch.tensor([[0.2, -0.1]]), atol=1e-3)


def test_displacement_ends_on_the_tangent_plane_along_the_normal() -> None:
    fit = fit_quadric(patch(), torch.ones(1, 200), ridge=RIDGE)
    move, normal = fit.displacement()[0], fit.normal()[0]
    assert torch.allclose(torch.linalg.cross(move, normal), torch.zeros(3), atol=1e-6)
    assert torch.allclose(move[2], 0.05 + 0.2 * move[0] - 0.1 * move[1], atol=1e-4)
    assert torch.allclose(normal.norm(), torch.tensor(1.0))


def test_weights_leave_a_second_surface_out() -> None:
    far = patch() + torch.tensor([0.0, 0.0, 0.7])
    both = torch.cat([patch(), far], 1)
    weight = torch.cat([torch.ones(1, 200), torch.zeros(1, 200)], 1)
    assert torch.allclose(
        fit_quadric(both, weight, ridge=RIDGE).height, fit_quadric(patch(), weight[:, :200], ridge=RIDGE).height
    )
    assert fit_quadric(both, torch.ones(1, 400), ridge=RIDGE).height > 0.3


def test_one_point_is_regular_and_stays() -> None:
    fit = fit_quadric(torch.zeros(1, 1, 3), torch.ones(1, 1), ridge=torch.full((6,), 1e-6))
    assert torch.equal(fit.displacement(), torch.zeros(1, 3))
    assert torch.equal(fit.normal(), torch.tensor([[0.0, 0.0, 1.0]]))


def test_gradient_reaches_the_weights() -> None:
    weight = torch.ones(1, 200, requires_grad=True)
    noisy = patch() + 0.05 * torch.randn(1, 200, 3, generator=torch.Generator().manual_seed(1))
    fit_quadric(noisy, weight, ridge=RIDGE).height.sum().backward()
    assert weight.grad is not None
    assert weight.grad.abs().max() > 1e-5
