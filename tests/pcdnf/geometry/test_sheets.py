import numpy as np
import torch
from scipy.spatial import cKDTree

from pcdnf.geometry.sheets import without_other_sheets, without_other_sheets_torch

UP = np.float32([0, 0, 1])


def wall(gap: float, noise: float = 0.002) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    side = np.repeat([-1.0, 1.0], 2000)
    points = np.c_[rng.uniform(-1, 1, (4000, 2)), side * gap / 2 + noise * rng.normal(size=4000)]
    index = cKDTree(points).query(points, 120)[1]
    return points, index, side


def test_the_other_side_of_a_wall_is_left_out() -> None:
    points, index, side = wall(0.1)
    normals, noise = np.tile(UP, (4000, 1)), np.full(4000, 0.002)
    kept = without_other_sheets(points, normals, index, noise, sided=False)
    other = side[index] != side[:, None]
    assert other.any(1).mean() > 0.9
    assert (kept[other] == -1).mean() > 0.95
    assert (kept[~other] == index[~other]).mean() > 0.999  # the noise of two points may be over four of one


def test_given_sides_tell_apart_what_no_gap_does() -> None:
    points, index, side = wall(0.004)
    normals, noise = (UP * side[:, None]).astype(np.float32), np.full(4000, 0.002)
    other = side[index] != side[:, None]
    assert (without_other_sheets(points, normals, index, noise, sided=False)[other] >= 0).mean() > 0.9
    kept = without_other_sheets(points, normals, index, noise, sided=True)
    assert (kept[other] == -1).all()
    assert (kept[~other] >= 0).mean() > 0.99


def test_a_ball_and_an_edge_lose_nothing() -> None:
    rng = np.random.default_rng(1)
    normals = rng.normal(size=(4000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    index = cKDTree(normals).query(normals, 200)[1]
    kept = without_other_sheets(normals, normals.astype(np.float32), index, np.full(4000, 1e-4), sided=False)
    assert np.array_equal(kept, index)
    flat = rng.uniform(0, 1, (2000, 2))
    edge = np.r_[np.c_[flat, np.zeros(2000)], np.c_[flat[:, :1], np.zeros(2000), flat[:, 1:]]]
    normals = np.repeat(np.float32([[0, 0, 1], [0, 1, 0]]), 2000, axis=0)
    index = cKDTree(edge).query(edge, 100)[1]
    assert np.array_equal(without_other_sheets(edge, normals, index, np.full(4000, 1e-4), sided=False), index)


def test_torch_leaves_out_the_same() -> None:
    points, index, side = wall(0.05)
    index[:, -7:] = -1
    normals, noise = (UP * side[:, None]).astype(np.float32), np.full(4000, 0.002)
    for sided in (False, True):
        ours = without_other_sheets(points, normals, index, noise, sided=sided)
        theirs = without_other_sheets_torch(*map(torch.from_numpy, (points, normals, index, noise)), sided=sided)
        assert (ours == theirs.numpy()).mean() > 0.9999
