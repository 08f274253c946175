import numpy as np
from scipy.spatial import cKDTree

from pcdnf.geometry.sides import tell_sides


def test_normals_out_of_a_ball_tell_the_sides_and_those_of_a_fit_do_not() -> None:
    rng = np.random.default_rng(0)
    ball = rng.normal(size=(3000, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    assert tell_sides(ball, ball, cKDTree(ball))
    assert not tell_sides(ball, ball * rng.choice([-1, 1], (3000, 1)), cKDTree(ball))
    assert not tell_sides(ball, np.zeros((3000, 3)), cKDTree(ball))


def test_a_wall_thinner_than_its_spacing_has_sides() -> None:
    rng = np.random.default_rng(1)
    side = rng.choice([-1.0, 1.0], 3000)
    wall = np.c_[rng.uniform(-1, 1, (3000, 2)), 0.004 * side + 0.001 * rng.normal(size=3000)]
    normals = np.c_[np.zeros((3000, 2)), side]
    for sign in (1, -1):
        assert tell_sides(wall, sign * normals, cKDTree(wall))
    assert not tell_sides(wall, normals * rng.choice([-1, 1], (3000, 1)), cKDTree(wall))
