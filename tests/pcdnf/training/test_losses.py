import math

import torch

from pcdnf.training.losses import Surface, angle_degrees, coplanar_loss, normal_loss, ortho_loss, point_terms

SIDE = torch.linspace(-1, 1, 21)
PLANE = torch.stack([*torch.meshgrid(SIDE, SIDE, indexing="ij"), torch.zeros(21, 21)], -1).reshape(1, -1, 3)
UP = torch.tensor([0.0, 0.0, 1.0]).expand_as(PLANE)


def test_projection_is_the_distance_to_a_plane() -> None:
    terms = point_terms(torch.tensor([[0.03, 0.02, 0.05]]), Surface(PLANE, UP))
    assert torch.allclose(terms.projection, torch.tensor([0.05]), atol=1e-6)
    assert torch.allclose(terms.nearest, torch.tensor([math.sqrt(0.03**2 + 0.02**2 + 0.05**2)]), atol=1e-6)
    assert torch.equal(terms.normal, torch.tensor([[0.0, 0.0, 1.0]]))


def test_the_other_side_of_an_edge_does_not_count() -> None:
    wall = PLANE[..., [2, 0, 1]] + torch.tensor([0.05, 0.0, 0.0])  # the plane x = 0.05
    surface = Surface(torch.cat([PLANE, wall], 1), torch.cat([UP, UP[..., [2, 0, 1]]], 1))
    terms = point_terms(torch.tensor([[-0.02, 0.0, 0.01]]), surface)
    assert torch.allclose(terms.projection, torch.tensor([0.01]), atol=2e-3)


def test_repulsion_is_the_largest_squared_distance() -> None:
    terms = point_terms(torch.zeros(1, 3), Surface(PLANE, UP))
    assert torch.allclose(terms.repulsion, torch.tensor([2.0]))


def test_far_away_points_still_have_a_gradient() -> None:
    move = torch.tensor([[0.0, 0.0, 3.0]], requires_grad=True)
    point_terms(move, Surface(PLANE, UP)).projection.sum().backward()
    assert move.grad is not None
    assert torch.allclose(move.grad, torch.tensor([[0.0, 0.0, 1.0]]), atol=1e-3)


def test_normals_are_compared_up_to_sign() -> None:
    up, side = torch.tensor([[0.0, 0, 1]]), torch.tensor([[1.0, 0, 0]])
    assert normal_loss(-up, up).item() == 0
    assert normal_loss(side, up).item() == 2
    assert torch.allclose(angle_degrees(3 * side, up), torch.tensor([90.0]))
    assert angle_degrees(-up, up).item() == 0


def test_ortho_loss_weighs_the_clean_points() -> None:
    clean = torch.tensor([[[0.5, 0, 0.1], [0.3, 0, 0.4]]])
    normal = torch.tensor([[0.0, 0, 2.0]])
    first = ortho_loss(torch.zeros(1, 3), normal, torch.tensor([[1.0, 0.0]]), clean)
    both = ortho_loss(torch.zeros(1, 3), normal, torch.tensor([[1.0, 1.0]]), clean)
    assert torch.allclose(first, torch.tensor([0.01]))
    assert torch.allclose(both, torch.tensor([(0.01 + 0.16) / 2]))


def test_true_weights_are_coplanar() -> None:
    wall = PLANE[..., [2, 0, 1]] + torch.tensor([0.5, 0.0, 0.0])  # the plane x = 0.5 beside the centre's, z = 0
    raised = PLANE + torch.tensor([0.0, 0.0, 0.3])  # the centre's direction, another height
    clean, normals = torch.cat([PLANE, wall, raised], 1), torch.cat([UP, UP[..., [2, 0, 1]], UP], 1)
    own = torch.zeros(1, clean.shape[1])
    own[:, : PLANE.shape[1]] = 1
    right, wrong, even = (
        coplanar_loss(weight, Surface(PLANE, UP), clean, normals).item() for weight in (own, 1 - own, 0.5 + 0 * own)
    )
    assert right < 1e-3
    assert wrong > 10
    assert math.isclose(even, math.log(2), rel_tol=1e-5)
