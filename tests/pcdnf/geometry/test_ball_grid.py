import numpy as np
import pytest
from scipy.spatial import cKDTree

from pcdnf.geometry.ball_grid import BallGrid, BallGrids

POINTS = np.random.default_rng(0).uniform(size=(4000, 3)) * [1, 0.7, 0.05]
IDS = np.arange(0, 4000, 37)
CROWD = 2000


def test_a_ball_holds_what_a_tree_finds() -> None:
    found = BallGrid(POINTS, 0.1, crowd=CROWD).subset(POINTS[IDS], IDS, 1500, seed=1)
    for i, row, wanted in zip(IDS, found, cKDTree(POINTS).query_ball_point(POINTS[IDS], 0.1), strict=True):
        assert set(row[row >= 0]) == set(wanted) - {i}


def test_far_negative_coordinates_and_empty_balls() -> None:
    points = np.array([[-1e3, 5.0, 2.0], [-1e3, 5.0, 2.05], [40.0, -7.0, 1.0]])
    found = BallGrid(points, 0.1, crowd=CROWD).subset(points, np.arange(3), 2, seed=0)
    assert found.tolist() == [[1, -1], [0, -1], [-1, -1]]


def test_subsets_depend_on_seed_and_index_alone() -> None:
    grid = BallGrid(POINTS, 0.1, crowd=CROWD)
    whole = grid.subset(POINTS[IDS], IDS, 20, seed=1)
    assert np.array_equal(whole[5:9], grid.subset(POINTS[IDS[5:9]], IDS[5:9], 20, seed=1))
    assert not np.array_equal(whole, grid.subset(POINTS[IDS], IDS, 20, seed=2))


def test_subsets_are_uniform_and_without_repeats() -> None:
    grid = BallGrid(POINTS, 0.1, crowd=CROWD)
    ball = grid.subset(POINTS[:1], np.array([0]), 4000, seed=0)[0]
    ball = ball[ball >= 0]
    drawn = np.stack([grid.subset(POINTS[:1], np.array([0]), 20, seed=s)[0] for s in range(2000)])
    assert all(len(set(row)) == 20 for row in drawn)
    counts = np.bincount(drawn.ravel(), minlength=4000)[ball]
    expected = 2000 * 20 / len(ball)
    assert abs(counts - expected).max() < 6 * np.sqrt(expected)


@pytest.mark.parametrize("inner", [0.03, 0.08])
def test_the_inner_ball_is_left_out(inner: float) -> None:
    found = BallGrid(POINTS, 0.1, crowd=CROWD).subset(POINTS[:1], np.array([0]), 1500, seed=0, inner=np.array([inner]))[
        0
    ]
    distance = np.linalg.norm(POINTS[found[found >= 0]] - POINTS[0], axis=1)
    assert distance.min() > inner
    assert distance.max() <= 0.1


def test_a_crowd_is_thinned_to_a_random_subset() -> None:
    crowd = np.random.default_rng(1).uniform(size=(60_000, 3)) * [0.3, 0.3, 0.01]
    crowd[0] = [1e6, 0, 0]  # and an outlier does not make one ball of everything
    grid = BallGrid(crowd, 0.1, crowd=CROWD)
    _, counts = np.unique(np.floor(crowd[grid.order] / 0.1), axis=0, return_counts=True)
    assert sorted(counts)[0] == 1
    assert all(0.9 * CROWD < count < 1.1 * CROWD for count in sorted(counts)[1:])
    found = grid.subset(crowd[5:9], np.arange(5, 9), 500, seed=0)
    assert (found >= 0).all()
    assert np.linalg.norm(crowd[found] - crowd[5:9, None], axis=-1).max() <= 0.1


def test_where_the_cloud_is_sparse_nothing_is_thinned() -> None:
    rng = np.random.default_rng(2)
    dense, sparse = rng.uniform(size=(30_000, 3)) * [0.3, 0.3, 0.01], rng.uniform(size=(300, 3)) * [0.3, 0.3, 0.01]
    points = np.concatenate([dense, sparse + np.array([5, 0, 0])])
    kept = BallGrid(points, 0.1, crowd=500).order
    assert (kept >= 30_000).sum() == 300
    assert 3000 < (kept < 30_000).sum() < 5000


def test_a_corner_of_a_dense_cloud_is_thinned_like_the_rest() -> None:
    points = np.random.default_rng(3).uniform(size=(100_000, 3)) * [0.21, 0.3, 0.01]  # the last cells are nearly empty
    kept = points[BallGrid(points, 0.1, crowd=500).order]
    share = [
        (kept[:, 0] < 0.1).mean() / (points[:, 0] < 0.1).mean(),
        (kept[:, 0] > 0.2).mean() / (points[:, 0] > 0.2).mean(),
    ]
    assert abs(share[0] - share[1]) < 0.15


def test_balls_of_different_radii_are_found_on_grids_that_suit_them() -> None:
    radius = np.random.default_rng(1).uniform(0.02, 0.2, len(POINTS))
    grids = BallGrids(POINTS, radius, crowd=10 * CROWD)
    found = grids.subset(IDS, 1500, seed=0)
    for own, row in zip(IDS, found, strict=True):
        inside = np.flatnonzero(np.linalg.norm(POINTS - POINTS[own], axis=1) <= radius[own])
        assert np.array_equal(np.sort(row[row >= 0]), inside[inside != own])
    assert len(grids.grids) > 4


def test_a_grid_of_small_balls_holds_their_surroundings_alone() -> None:
    radius = np.where(POINTS[:, 0] < np.median(POINTS[:, 0]), 0.02, 0.3)
    grids = BallGrids(POINTS, radius, crowd=10 * CROWD)
    small = min(grids.grids)
    assert len(grids.grids[small].order) < 0.7 * len(POINTS)
    alone = BallGrids(POINTS, np.full(len(POINTS), 0.02), crowd=10 * CROWD)
    own = np.flatnonzero(radius == 0.02)[:50]
    ours, theirs = grids.subset(own, 400, seed=3), alone.subset(own, 400, seed=3)
    assert np.array_equal(np.sort(ours, 1), np.sort(theirs, 1))


def test_balls_far_smaller_than_the_cloud_are_found() -> None:
    points = np.r_[POINTS, POINTS + 1e9]
    found = BallGrids(points, np.full(len(points), 0.1), crowd=10 * CROWD).subset(IDS, 1500, seed=0)
    inside = [np.flatnonzero(np.linalg.norm(POINTS - POINTS[own], axis=1) <= 0.1) for own in IDS]
    assert [(row >= 0).sum() for row in found] == [len(each) - 1 for each in inside]
