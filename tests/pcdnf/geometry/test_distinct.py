import numpy as np

from pcdnf.geometry.distinct import distinct_points, void_rows


def test_copies_count_once_in_the_order_of_their_first_rows() -> None:
    points = np.array([[3.0, 0, 0], [1, 0, 0], [3, 0, 0], [2, 0, 0], [1, 0, -0.0]])
    found = distinct_points(points)
    assert found.rows.tolist() == [0, 1, 3]
    assert found.of.tolist() == [0, 1, 0, 2, 1]
    assert not found.all_rows


def test_a_cloud_without_copies_stays_in_order() -> None:
    points = np.random.default_rng(0).normal(size=(500, 3))
    found = distinct_points(points)
    assert found.all_rows
    assert np.array_equal(found.rows, np.arange(500))
    assert np.array_equal(found.of, np.arange(500))


def test_rows_of_zeros_are_no_measurements_unless_there_is_one_alone() -> None:
    points = np.random.default_rng(0).normal(size=(6, 3))
    points[2] = 0
    assert not void_rows(points).any()
    assert len(distinct_points(points).rows) == 6
    points[4] = 0
    found = distinct_points(points)
    assert found.of.tolist() == [0, 1, -1, 2, -1, 3]
    assert found.rows.tolist() == [0, 1, 3, 5]
