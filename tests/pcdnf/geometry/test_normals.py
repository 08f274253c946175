import numpy as np
import pytest
from scipy.spatial import cKDTree

from pcdnf.geometry.normals import CHUNK, ball_normals, pca_normals, raw_normals, unit_towards


def test_normals_of_a_sphere_are_radial() -> None:
    points = np.random.default_rng(0).normal(size=(20_000, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    normals = pca_normals(points)
    assert normals.dtype == np.float32
    angle = np.degrees(np.arccos(np.clip(np.abs((normals * points).sum(1)), 0, 1)))
    assert angle.mean() < 1.5


def test_agrees_with_open3d() -> None:
    open3d = pytest.importorskip("open3d")
    points = np.random.default_rng(1).normal(size=(3000, 3)) * [1, 1, 0.1]
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    cloud.estimate_normals(open3d.geometry.KDTreeSearchParamKNN(24), fast_normal_computation=False)
    cosine = np.abs((pca_normals(points, 24) * np.asarray(cloud.normals)).sum(1))
    assert np.quantile(cosine, 0.001) > 0.9999


def test_fewer_points_than_neighbours() -> None:
    points = np.random.default_rng(2).normal(size=(10, 3)) * [1, 1, 0]
    assert np.allclose(np.abs(pca_normals(points, 24)), [[0, 0, 1]] * 10)


def test_check_is_called_between_chunks_and_may_stop() -> None:
    calls = []

    def check() -> None:
        calls.append(1)
        if len(calls) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        pca_normals(np.random.default_rng(3).normal(size=(CHUNK + 5, 3)), check=check)


def test_the_side_of_given_normals_counts_whatever_their_length() -> None:
    points = np.random.default_rng(3).normal(size=(400, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    for length in (1e-30, 1e-3, 1e30):
        found = raw_normals(points, length * points, tree=cKDTree(points), replace=True)
        assert ((found * points).sum(1) > 0.5).all(), length


def test_given_normals_are_used_and_missing_ones_filled_in() -> None:
    points = np.random.default_rng(4).normal(size=(300, 3)) * [1, 1, 0]
    given = np.tile([3.0, 0.0, 4.0], (300, 1))
    given[5], given[6, 1] = 0, np.nan
    normals = raw_normals(points, given, tree=cKDTree(points))
    assert np.allclose(normals[0], [0.6, 0, 0.8])
    assert np.allclose(np.abs(normals[[5, 6]]), [0, 0, 1], atol=1e-6)


def test_normals_are_turned_to_a_side() -> None:
    turned = unit_towards(np.array([[0, 0, 2.0], [0, 0, -2.0]]), np.array([[0, 0.1, -1.0], [0, 0, -1.0]]))
    assert np.array_equal(turned, [[0, 0, -1.0], [0, 0, -1.0]])


def test_points_without_neighbours_in_their_ball_take_the_nearest() -> None:
    rng = np.random.default_rng(0)
    floor = np.c_[rng.uniform(0, 1, (3000, 2)), np.zeros(3000)]
    wall = np.c_[np.full(60, 3.0), rng.uniform(0, 1, 60), rng.uniform(0, 1, 60)]  # a fiftieth as dense
    normals = ball_normals(np.r_[floor, wall], 0.08)
    assert np.abs(normals[:3000, 2]).min() > 0.999
    assert np.abs(normals[3000:, 0]).min() > 0.999
