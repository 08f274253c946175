"""Clean clouds: files, noisy versions beside them, shapes by formula."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pcdnf.benchmark.clouds import analytic_clouds, generated_clouds, read_clouds
from pcdnf.errors import PcdnfError
from pcdnf.formats import PointCloud, write
from pcdnf.metrics import normal_error

POINTS = np.random.default_rng(0).uniform(size=(50, 3))


def test_files_and_folders_of_every_kind(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", POINTS)
    np.savez(tmp_path / "b.npz", points=POINTS, normals=POINTS)
    write(tmp_path / "c_noise.ply", PointCloud(points=POINTS))  # no level in its name: a cloud like others
    (tmp_path / "notes.txt").write_text("not a cloud")
    clouds = read_clouds([tmp_path])
    assert [cloud.name for cloud in clouds] == ["a", "b", "c_noise"]
    assert [cloud.normals is None for cloud in clouds] == [True, False, True]
    assert [cloud.name for cloud in read_clouds([tmp_path / "b.npz", tmp_path / "a.npy"])] == ["a", "b"]


def test_a_noisy_version_beside_a_cloud_is_taken(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", POINTS)
    np.save(tmp_path / "a_noise0.5.npy", POINTS + 1)
    np.save(tmp_path / "lone_noise2.npy", POINTS)
    a, lone = read_clouds([tmp_path])
    assert lone.name == "lone_noise2"
    assert np.array_equal(a.noisy(0.5), POINTS + 1)
    assert not np.array_equal(a.noisy(0.5, "laplace"), POINTS + 1)
    expected = np.random.default_rng(0).normal(size=POINTS.shape) * 0.01 * np.linalg.norm(np.ptp(POINTS, axis=0))
    np.testing.assert_allclose(a.noisy(1.0) - POINTS, expected, atol=1e-12)
    thin = a.thinned(10)
    assert np.array_equal(thin.noisy(0.5), thin.points + 1)
    assert np.array_equal(thin.points, a.thinned(10).points)
    assert a.thinned(50) is a


def test_what_cannot_be_used_is_said(tmp_path: Path) -> None:
    with pytest.raises(PcdnfError, match="contains no clean cloud"):
        read_clouds([tmp_path])
    np.save(tmp_path / "a.npy", POINTS)
    np.save(tmp_path / "a_noise0.5.npy", POINTS[:9])
    with pytest.raises(PcdnfError, match=r"9 points, but a\.npy has 50") as raised:
        read_clouds([tmp_path])
    assert raised.value.hint
    (tmp_path / "a_noise0.5.npy").unlink()
    with pytest.raises(PcdnfError, match="Two clouds are named a"):
        read_clouds([tmp_path, tmp_path / "a.npy"])


def test_shapes_by_formula_have_their_normals_and_even_density() -> None:
    clouds = analytic_clouds(3000)
    assert [cloud.name for cloud in clouds] == ["block", "can", "knoll", "ring"]
    for cloud, again in zip(clouds, analytic_clouds(3000), strict=True):
        assert cloud.points.shape == (3000, 3)
        assert cloud.digest() == again.digest()
        assert cloud.normals is not None
        np.testing.assert_allclose(np.linalg.norm(cloud.normals, axis=1), 1, atol=1e-9)
        mean, _ = normal_error(cloud.points, cloud.normals, cloud.points)  # against PCA of 12 neighbours
        assert mean < 7
        distance = np.linalg.norm(cloud.points[:, None] - cloud.points[None, :300], axis=-1)
        count = (distance < np.partition(distance, 60, axis=0)[60].mean()).sum(0)
        assert np.percentile(count, 2) > 30  # no place is sparse


def test_generated_shapes_come_from_seeds_of_their_own() -> None:
    (shape,) = generated_clouds(1, 2000)
    assert shape.name == "shape-0"
    assert shape.points.shape == (2000, 3)
    assert shape.digest() == generated_clouds(1, 2000)[0].digest()
