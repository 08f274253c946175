import numpy as np
from scipy.spatial import cKDTree

from pcdnf.geometry.flat_fits import flat_fits

NOISE = 0.001


def stairs(count: int = 6000) -> tuple[np.ndarray, np.ndarray]:
    """Steps far higher than the noise and not much longer than the spacing, with long landings; the true height."""
    rng = np.random.default_rng(0)
    flat = rng.uniform(0, 4, (count, 2))
    height = np.where(flat[:, 0] < 2, 0.0, 0.2 * np.floor(12 * (flat[:, 0] - 2)))
    return np.c_[flat, height + NOISE * rng.normal(size=count)], height


def test_landings_come_nearer_and_steps_stay() -> None:
    points, height = stairs()
    rows = np.arange(len(points))
    move, normal = flat_fits(points, rows, np.full(len(rows), NOISE), tree=cKDTree(points))
    before, after = np.abs(points[:, 2] - height), np.abs((points + move)[:, 2] - height)
    landing = points[:, 0] < 1.7
    assert after[landing].mean() < 0.4 * before[landing].mean()
    assert after.mean() < before.mean()
    assert (after > before + NOISE).mean() < 0.01
    still = ~move.any(1)
    assert still[landing].mean() < 0.05
    assert still[points[:, 0] > 2].mean() > 0.5
    assert np.abs(normal[landing][np.isfinite(normal[landing]).all(1)][:, 2]).min() > 0.99


def test_no_move_is_longer_than_the_noise_explains() -> None:
    points, _ = stairs()
    points[7, 2] += 20 * NOISE
    move, _ = flat_fits(points, np.arange(50), np.full(50, NOISE), tree=cKDTree(points))
    assert np.linalg.norm(move, axis=1).max() <= 3 * NOISE * (1 + 1e-9)
    assert not move[7].any()


def test_without_noise_nothing_moves() -> None:
    points, _ = stairs()
    assert not flat_fits(points, np.arange(100), np.zeros(100), tree=cKDTree(points))[0].any()


def test_a_handful_of_points_stays() -> None:
    points = np.random.default_rng(1).normal(size=(12, 3))
    move, normal = flat_fits(points, np.arange(12), np.ones(12), tree=cKDTree(points))
    assert not move.any()
    assert np.isnan(normal).all()
