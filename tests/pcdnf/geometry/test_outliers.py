import numpy as np
import pytest

from pcdnf.formats import PointCloud
from pcdnf.geometry.outliers import drop_outliers, outlier_rows, treat_outliers
from tests.support.clouds import depth_image, noisy_sphere


def test_points_far_from_all_others_are_found_and_no_others() -> None:
    points = noisy_sphere(6000, 0.005)
    rng = np.random.default_rng(1)
    wild = np.sort(rng.choice(6000, 60, replace=False))
    points[wild] *= rng.uniform(1.6, 2.5, (60, 1))
    found = outlier_rows(points)
    assert np.isin(wild, found).mean() > 0.95
    assert len(np.setdiff1d(found, wild)) < 12


def test_a_sparse_side_of_a_scan_is_no_outlier() -> None:
    points = noisy_sphere(8000, 0.003)
    rng = np.random.default_rng(2)
    kept = points[rng.random(8000) < np.clip((points[:, 2] + 1) / 2, 0.05, 1)]
    assert len(outlier_rows(kept)) < 0.01 * len(kept)


def test_dropping_says_which_rows_of_the_file_went() -> None:
    points = noisy_sphere(500, 0.005)
    points[[3, 100]] = [[4, 4, 4], [-5, 3, 3]]
    colours = np.arange(500, dtype=np.uint8)
    cloud = PointCloud(points=points, attributes={"red": colours}).without(np.array([0]), "First rows")
    left = drop_outliers(cloud)
    assert left.dropped.tolist() == [0, 3, 100]
    assert len(left) == 497
    assert left.attributes["red"].tolist() == np.delete(colours, [0, 3, 100]).tolist()
    assert any("Outliers were left out: 3, 100" in warning for warning in left.warnings)
    recorded = left.replaced(left.points, None, metadata={}).metadata
    assert recorded["dropped_rows"].startswith("0, 3, 100")


def test_a_cloud_without_outliers_stays_as_it_is() -> None:
    cloud = PointCloud(points=noisy_sphere(400, 0.0))
    assert drop_outliers(cloud) is cloud


def test_copies_of_points_make_the_others_no_outliers() -> None:
    points = noisy_sphere(400, 0.005)
    copies = np.concatenate([np.repeat(points[:300], 20, axis=0), points[300:], [[9.0, 9.0, 9.0]]])
    assert outlier_rows(copies).tolist() == [len(copies) - 1]


@pytest.mark.parametrize("count", [0, 1, 2, 40])
def test_too_few_or_equal_points_have_no_outlier(count: int) -> None:
    assert outlier_rows(np.ones((count, 3))).dtype == np.int64
    assert not len(outlier_rows(np.ones((count, 3))))


def test_a_thin_wire_is_no_outlier() -> None:
    wire = np.column_stack([np.linspace(0, 6, 12), np.zeros(12), np.full(12, 5.0)])
    points = np.concatenate([noisy_sphere(4000, 0.005), wire, [[0.0, 20, 0]]])
    assert outlier_rows(points).tolist() == [len(points) - 1]


def test_rows_of_zeros_are_no_outliers() -> None:
    points = np.concatenate([noisy_sphere(2000, 0.005) + 50, np.zeros((9, 3))])
    assert not len(outlier_rows(points))


def test_the_sensor_shows_points_between_two_surfaces() -> None:
    points, kinds = depth_image()
    assert np.isin(np.flatnonzero(kinds["flying"]), outlier_rows(points, (0, 0, 0))).mean() > 0.9
    assert np.isin(np.flatnonzero(kinds["flying"]), outlier_rows(points)).mean() < 0.5


def test_marking_adds_a_column_and_keeps_every_point() -> None:
    points = noisy_sphere(500, 0.005)
    points[[3, 100]] = [[4, 4, 4], [-5, 3, 3]]
    marked = treat_outliers(PointCloud(points=points).aside(np.array([0]), "One row."), "mark").whole()
    assert np.flatnonzero(marked.attributes["outlier"]).tolist() == [3, 100]
    assert marked.attributes["outlier"].dtype == np.uint8
    np.testing.assert_array_equal(marked.points, points)
    assert not any("Outliers" in warning for warning in marked.warnings)


def test_keeping_changes_nothing() -> None:
    cloud = PointCloud(points=np.concatenate([noisy_sphere(500, 0.005), [[9.0, 9, 9]]]))
    assert treat_outliers(cloud, "keep") is cloud
