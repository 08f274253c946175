import manifold3d
import numpy as np
import pytest
from scipy.spatial import cKDTree

from pcdnf.training import shapes
from pcdnf.training.shapes import random_shape


@pytest.mark.parametrize("seed", range(6))
def test_clouds_are_centred_of_diagonal_one_with_unit_normals(seed: int) -> None:
    shape = random_shape(np.random.default_rng(seed), 4000)
    assert shape.points.shape == shape.normals.shape == (4000, 3)
    assert np.isclose(np.linalg.norm(np.ptp(shape.points, axis=0)), 1)
    assert np.allclose(shape.points.min(0), -shape.points.max(0))
    assert np.allclose(np.linalg.norm(shape.normals, axis=1), 1)


@pytest.mark.parametrize("seed", [1, 2, 5])
def test_normals_are_those_of_the_surface(seed: int) -> None:
    """Seen along a point's normal, its nearest neighbours lie at nearly the same height."""
    shape = random_shape(np.random.default_rng(seed), 40_000)
    distance, index = cKDTree(shape.points).query(shape.points, 6)
    height = ((shape.points[index] - shape.points[:, None]) * shape.normals[:, None]).sum(-1)
    slope = np.abs(height[:, 1:]) / np.maximum(distance[:, 1:], 1e-9)
    assert np.median(slope) < 0.12


def test_a_seed_is_a_shape() -> None:
    first, second = (random_shape(np.random.default_rng(2), 4000).points for _ in range(2))
    assert np.array_equal(first, second)


def test_an_empty_solid_is_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = shapes._primitive
    made = iter(["empty"] * 9)
    monkeypatch.setattr(
        shapes, "_primitive", lambda rng, thin: manifold3d.Manifold() if next(made, None) else whole(rng, thin)
    )
    assert random_shape(np.random.default_rng(3), 1000).points.shape == (1000, 3)


def test_thin_shapes_are_of_plates() -> None:
    rng = np.random.default_rng(4)
    opposite = []
    for _ in range(4):
        shape = random_shape(rng, 4000, thin=True)
        inside = shape.points - 0.05 * shape.normals  # through a plate, which is thinner, to its other side
        opposite.append(np.median(cKDTree(shape.points).query(inside)[0]))
    assert np.median(opposite) < 0.04
