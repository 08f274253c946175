import numpy as np
import pytest
from scipy.spatial import cKDTree

from pcdnf.geometry.local_scale import LocalScale, estimate_local_scale
from pcdnf.geometry.morton import spatial_order
from pcdnf.geometry.noise import estimate_noise


def estimate(points: np.ndarray) -> LocalScale:
    size = np.abs(points).max()
    return estimate_local_scale(points, cKDTree(points), spatial_order(points / (2.1 * size)))


def sheet(count: int, seed: int = 0) -> np.ndarray:
    return np.c_[np.random.default_rng(seed).uniform(-1, 1, (count, 2)), np.zeros(count)]


def inner(points: np.ndarray) -> np.ndarray:
    return np.abs(points[:, :2]).max(1) < 0.8


def test_noise_and_spacing_follow_the_place() -> None:
    rng = np.random.default_rng(1)
    points = sheet(40_000)
    points = points[(points[:, 0] < 0) | (rng.random(len(points)) < 0.1)]  # a tenth of the density to the right
    true = np.where(points[:, 1] < 0, 0.002, 0.02)
    points[:, 2] = true * rng.normal(size=len(points))
    scale = estimate(points)
    for left in (True, False):
        for low in (True, False):
            here = inner(points) & ((points[:, 0] < -0.2) if left else (points[:, 0] > 0.2))
            here &= (points[:, 1] < -0.2) if low else (points[:, 1] > 0.2)
            spacing = np.sqrt(4 / 40_000 * (1 if left else 10))
            assert np.median(scale.noise[here]) == pytest.approx(0.002 if low else 0.02, rel=0.15)
            assert np.median(scale.spacing[here]) == pytest.approx(spacing, rel=0.2)


def test_noise_that_is_alike_over_some_spacings_is_not_taken_for_shape() -> None:
    rng = np.random.default_rng(2)
    points = sheet(20_000)
    index = cKDTree(points).query(points, 25)[1]
    bumps = rng.normal(size=len(points))[index].mean(1)  # the mean of 25 neighbours' draws
    points[:, 2] = 0.014 * bumps / bumps.std()
    scale = estimate(points)
    found = np.median(scale.noise[inner(points)]) / 0.014
    assert 0.55 < found < 1.2
    assert found > 1.5 * estimate_noise(points, cKDTree(points)).noise / 0.014


def test_edges_are_not_taken_for_noise() -> None:
    """Steps 40 noises high, four spacings apart from their neighbours at the nearest."""
    rng = np.random.default_rng(3)
    points = sheet(40_000)
    points[:, 2] = 0.08 * (np.floor(4 * points[:, 0]) % 2) + 0.002 * rng.normal(size=len(points))
    scale = estimate(points)
    assert np.median(scale.noise) == pytest.approx(0.002, rel=0.15)
    assert np.quantile(scale.noise, 0.95) < 0.004


def test_slight_noise_between_unresolved_shape_stays_slight() -> None:
    rng = np.random.default_rng(4)
    points = sheet(5000)
    points[:, 2] = np.where(np.abs(points[:, 0]) < 0.3, 0.3 * rng.random(len(points)), 0.0005 * rng.normal(size=5000))
    scale = estimate(points)
    plain = inner(points) & (np.abs(points[:, 0]) > 0.5)
    assert np.median(scale.noise[plain]) == pytest.approx(0.0005, rel=0.25)


def test_two_sheets_that_nothing_resolves_are_seen() -> None:
    rng = np.random.default_rng(5)
    points = sheet(8000)
    points[:, 2] = 0.01 * rng.choice([-1, 1], 8000) + 0.002 * rng.normal(size=8000)
    scale = estimate(points)
    assert scale.double[inner(points)].mean() > 0.9
    assert np.median(scale.noise) == pytest.approx(0.002, rel=0.4)
    assert not estimate(np.c_[points[:, :2], 0.01 * rng.normal(size=8000)]).double.any()


def test_deep_noise_is_measured_beyond_the_usual_neighbourhoods() -> None:
    rng = np.random.default_rng(6)
    points = sheet(40_000)
    points[:, 2] = 0.08 * rng.normal(size=len(points))
    assert np.median(estimate(points).noise[inner(points)]) == pytest.approx(0.08, rel=0.2)


def test_what_lies_elsewhere_changes_nothing() -> None:
    rng = np.random.default_rng(7)
    points = sheet(20_000) + 0.004 * rng.normal(size=(20_000, 3))
    alone = estimate(points)
    far = rng.normal(size=(200, 3)) * 100 + 300
    other = np.r_[sheet(5000) * 4 + [30, 0, 0], far]
    together = estimate(np.r_[points, other])
    for ours, theirs in zip((alone.noise, alone.spacing), (together.noise, together.spacing), strict=True):
        assert np.median(np.abs(np.log(ours / theirs[:20_000]))) < 0.06
    assert alone.extent[0] == pytest.approx(together.extent[0], rel=0.02)
    assert together.extent[20_000] == pytest.approx(4 * alone.extent[0], rel=0.1)


def test_points_far_off_do_not_enlarge_the_object_that_they_surround() -> None:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        points = np.c_[rng.uniform(-1, 1, (6000, 2)), 0.01 * rng.normal(size=6000)]
        way = rng.normal(size=(90, 3))
        far = way / np.linalg.norm(way, axis=1, keepdims=True) * 60 * rng.uniform(0.3, 1, (90, 1))
        extent = estimate(np.r_[points, far]).extent[:6000]
        assert np.median(extent) == pytest.approx(np.sqrt(8), rel=0.05), seed


def test_small_clouds_have_a_scale() -> None:
    for count in (16, 40, 200):
        scale = estimate(sheet(count) + 0.01 * np.random.default_rng(8).normal(size=(count, 3)))
        assert np.isfinite(scale.noise + scale.spacing + scale.extent).all()
        assert (scale.spacing > 0).all()
