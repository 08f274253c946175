import json

import numpy as np
import pytest

from pcdnf.geometry.morton import spatial_order
from pcdnf.inference.tiles import tiles
from pcdnf.inference.unit_frame import CloudError, UnitFrame, checked_points

POINTS = np.random.default_rng(0).normal(size=(500, 3))


def test_local_coordinates_have_diagonal_one_at_any_place_and_scale() -> None:
    utm = POINTS * 30 + [448_000.12, 4_480_000.37, 12.5]
    local = UnitFrame.of(utm).to_local(utm)
    assert np.isclose(np.linalg.norm(np.diff(np.quantile(local, (0.005, 0.995), axis=0), axis=0)), 1)
    assert np.abs(local - UnitFrame.of(POINTS).to_local(POINTS)).max() < 1e-9


def test_a_frame_survives_json() -> None:
    frame = UnitFrame.of(POINTS * 1e7 + 0.1)
    again = UnitFrame.from_json(json.loads(json.dumps(frame.to_json())))
    assert np.array_equal(again.centre, frame.centre)
    assert again.diagonal == frame.diagonal


@pytest.mark.parametrize(
    ("points", "code"),
    [
        (np.ones((20, 3)), "zero_extent"),
        (POINTS * 1e13, "extent_out_of_range"),
        (POINTS * 1e-14, "extent_out_of_range"),
        (np.vstack([POINTS, [[np.nan, 0, 0]]]), "nonfinite"),
        (np.vstack([POINTS, [[0, np.inf, 0]]]), "nonfinite"),
    ],
)
def test_bad_extents_have_their_own_code_and_advice(points: np.ndarray, code: str) -> None:
    with pytest.raises(CloudError) as caught:
        UnitFrame.of(points)
    assert caught.value.code == code
    assert caught.value.hint


def test_spatial_order_is_a_permutation_that_keeps_neighbours_together() -> None:
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (5000, 3))
    order = spatial_order(points)
    assert sorted(order) == list(range(5000))
    step = np.linalg.norm(np.diff(points[order], axis=0), axis=1).mean()
    assert step < 0.3 * np.linalg.norm(np.diff(points, axis=0), axis=1).mean()


def test_tiles_cover_everything_once() -> None:
    assert tiles(10, 4) == [(0, 4), (4, 8), (8, 10)]
    assert tiles(4, 4) == [(0, 4)]


def test_noise_and_outliers_hardly_change_the_diagonal() -> None:
    rng = np.random.default_rng(0)
    cube = rng.uniform(-0.5, 0.5, (20_000, 3))
    cube[np.arange(20_000), rng.integers(3, size=20_000)] = rng.choice([-0.5, 0.5], 20_000)
    noisy = cube + rng.normal(size=cube.shape) * 0.02
    noisy[7] = [1e6, 0, 0]
    assert abs(UnitFrame.of(noisy).diagonal / UnitFrame.of(cube).diagonal - 1) < 0.08


def test_a_few_points_beside_many_equal_ones_still_have_a_frame() -> None:
    points = np.zeros((1000, 3))
    points[:3] = np.eye(3)
    assert np.isclose(UnitFrame.of(points).diagonal, np.sqrt(3), rtol=0.02)  # without the tails of its box


def test_arrays_that_are_no_points() -> None:
    for values in ([[1, 2, 3], [4, 5]], [["a", "b", "c"]], np.ones((20, 3), complex), None):
        with pytest.raises(CloudError, match="real numbers") as caught:
            checked_points(values, 1)  # type: ignore[arg-type]
        assert caught.value.code == "bad_shape"
    assert checked_points([[1, 2, 3]], 1).dtype == np.float64
    given = np.random.default_rng(0).normal(size=(20, 3))
    assert checked_points(given, 20) is given
