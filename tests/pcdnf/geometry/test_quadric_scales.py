import numpy as np
import pytest
from scipy.spatial import cKDTree

from pcdnf.geometry.quadric_scales import fit_scales

SIZES = np.array([12, 40, 120])


def paraboloid(noise: float, count: int = 4000) -> np.ndarray:
    rng = np.random.default_rng(0)
    flat = rng.uniform(-1, 1, (count, 2))
    return np.c_[flat, 0.2 * (flat**2).sum(1) + noise * rng.normal(size=count)]


def test_a_quadric_leaves_nothing_and_its_normal_is_exact() -> None:
    points = paraboloid(0)
    rows = np.flatnonzero(np.linalg.norm(points[:, :2], axis=1) < 0.1)
    fits = fit_scales(points, rows, SIZES, tree=cKDTree(points))
    assert fits.scatter.max() < 2e-4  # a paraboloid is a quadric in its own frame alone
    truth = np.c_[-0.4 * points[rows, :2], np.ones(len(rows))]
    truth /= np.linalg.norm(truth, axis=1, keepdims=True)
    assert np.abs((fits.normal * truth[:, None]).sum(-1)).min() > 0.9999


def test_scatter_is_the_noise_at_every_size_and_height_has_the_spread_that_leverage_says() -> None:
    points = paraboloid(0.002)
    rows = np.flatnonzero(np.abs(points[:, :2]).max(1) < 0.7)
    fits = fit_scales(points, rows, SIZES, tree=cKDTree(points))
    assert np.median(fits.scatter, axis=0) == pytest.approx(np.full(3, 0.002), rel=0.1)
    foot = points[rows, None] + fits.height[..., None] * fits.normal
    off = foot[..., 2] - 0.2 * (foot[..., :2] ** 2).sum(-1)
    assert np.sqrt((off**2 / fits.leverage).mean(0)) == pytest.approx(np.full(3, 0.002), rel=0.15)
    assert (np.diff(fits.leverage.mean(0)) < 0).all()


def test_kurtosis_tells_two_sheets_from_noise() -> None:
    rng = np.random.default_rng(1)
    flat, side = rng.uniform(-1, 1, (4000, 2)), rng.choice([-1, 1], 4000)
    rows = np.flatnonzero(np.abs(flat).max(1) < 0.7)
    one = np.c_[flat, 0.01 * rng.normal(size=4000)]
    two = np.c_[flat, 0.01 * side + 0.002 * rng.normal(size=4000)]
    single, double = (np.median(fit_scales(p, rows, SIZES, tree=cKDTree(p)).kurtosis[:, -1]) for p in (one, two))
    assert single == pytest.approx(3, abs=0.4)
    assert double < 1.5


def test_a_fit_does_not_depend_on_the_others_and_takes_as_many_neighbours_as_it_may() -> None:
    points = paraboloid(0.01)
    tree, rows = cKDTree(points), np.arange(0, 4000, 9)
    whole, alone = (fit_scales(points, chosen, SIZES, tree=tree) for chosen in (rows, rows[5:6]))
    assert np.array_equal(whole.height[5], alone.height[0])
    thinned = fit_scales(points, rows, SIZES, tree=tree, most=40)
    assert np.array_equal(thinned.scatter[:, 1], whole.scatter[:, 1])
    assert np.median(thinned.scatter[:, 2]) == pytest.approx(np.median(whole.scatter[:, 2]), rel=0.05)


def test_copies_of_one_point_have_no_fit() -> None:
    points = np.zeros((40, 3))
    assert np.isnan(fit_scales(points, np.arange(3), SIZES[:2], tree=cKDTree(points)).scatter).all()
