import numpy as np
import pytest

from pcdnf.geometry.orientation import orient_normals


def torus(count: int = 6000) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    u, v = rng.uniform(0, 2 * np.pi, (2, count))
    ring = np.stack([np.cos(u), np.sin(u), np.zeros(count)], 1)
    normals = ring * np.cos(v)[:, None] + np.array([0, 0, 1.0]) * np.sin(v)[:, None]
    return ring + 0.3 * normals, normals


def scrambled(normals: np.ndarray) -> np.ndarray:
    return normals * np.random.default_rng(1).choice([-1.0, 1.0], (len(normals), 1))


def test_every_normal_looks_outwards() -> None:
    points, normals = torus()
    found = orient_normals(points, scrambled(normals).astype(np.float32))
    assert found.dtype == np.float32
    assert ((found * normals).sum(1) > 0).mean() > 0.999


def test_it_agrees_with_open3d() -> None:
    o3d = pytest.importorskip("open3d")
    points, normals = torus()
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud.normals = o3d.utility.Vector3dVector(scrambled(normals))
    cloud.orient_normals_consistent_tangent_plane(10)
    agree = (np.asarray(cloud.normals) * orient_normals(points, scrambled(normals))).sum(1) > 0
    assert agree.mean() > 0.999 or agree.mean() < 0.001  # Open3D does not say which side is out


def test_each_piece_is_turned_by_itself() -> None:
    points, normals = torus(3000)
    both = np.concatenate([points, points + 10])
    found = orient_normals(both, scrambled(np.concatenate([normals, normals])))
    assert ((found * np.concatenate([normals, normals])).sum(1) > 0).mean() > 0.999


def test_the_callers_side_decides() -> None:
    points, normals = torus(3000)
    mostly_inward = -normals
    mostly_inward[::5] *= -1
    found = orient_normals(points, scrambled(normals), like=mostly_inward)
    assert ((found * normals).sum(1) < 0).mean() > 0.999


def test_a_handful_of_points_is_enough() -> None:
    found = orient_normals(np.eye(3), np.eye(3))
    assert np.abs(found).tolist() == np.eye(3).tolist()


def test_rows_that_are_not_finite_have_no_say() -> None:
    points, normals = torus(3000)
    for side in (-1.0, 1.0):
        like = side * normals
        like[7] = np.nan
        like[9, 1] = np.inf
        found = orient_normals(points, scrambled(normals), like=like)
        assert ((found * normals).sum(1) * side > 0).mean() > 0.999
