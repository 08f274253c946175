import numpy as np
import pytest
from scipy.spatial import cKDTree

from pcdnf.geometry.noise import NoiseEstimate, clean_spacing, estimate_noise, normals_reach
from tests.support.clouds import noisy_sphere


@pytest.mark.parametrize("count", [3000, 40_000])
@pytest.mark.parametrize("noise", [0.002, 0.01, 0.03])
def test_noise_and_spacing_of_a_sphere(count: int, noise: float) -> None:
    points = noisy_sphere(count, noise)
    scale = estimate_noise(points, cKDTree(points))
    assert scale.noise == pytest.approx(noise, rel=0.3)
    assert scale.spacing == pytest.approx(np.sqrt(4 * np.pi / count), rel=0.25)


def test_a_clean_cloud_has_no_noise() -> None:
    points = noisy_sphere(20_000, 0.0)
    tree = cKDTree(points)
    scale = estimate_noise(points, tree)
    assert scale.noise < 0.01 * scale.spacing
    assert scale.spacing == pytest.approx(clean_spacing(tree), rel=0.05)


def test_the_unit_does_not_matter() -> None:
    points = noisy_sphere(5000, 0.01)
    here, there = estimate_noise(points, cKDTree(points)), estimate_noise(points * 1e4, cKDTree(points * 1e4))
    assert there.noise == pytest.approx(here.scaled(1e4).noise)
    assert there.spacing == pytest.approx(here.scaled(1e4).spacing)


@pytest.mark.parametrize("count", [6, 16, 40])
def test_few_or_equal_points_have_a_finite_scale(count: int) -> None:
    for points in (noisy_sphere(count, 0.01), np.zeros((count, 3)), np.linspace(0, 1, count)[:, None] * np.ones(3)):
        scale = estimate_noise(points, cKDTree(points))
        assert np.isfinite(scale.noise)
        assert np.isfinite(scale.spacing)


def test_rounding_hides_the_last_digits() -> None:
    assert (
        NoiseEstimate(0.123456, 0.0098765).rounded()
        == NoiseEstimate(0.123456 + 1e-9, 0.0098765).rounded()
        == NoiseEstimate(0.123, 0.00988)
    )


def test_normals_are_taken_from_enough_points_and_beyond_the_noise() -> None:
    assert normals_reach(0.1, NoiseEstimate(0.02, 0.001)) == pytest.approx(0.06)
    assert normals_reach(0.1, NoiseEstimate(0.001, 0.001)) == pytest.approx(0.04)
    assert normals_reach(0.1, NoiseEstimate(0.001, 0.03)) == pytest.approx(0.075)
    assert normals_reach(0.1, NoiseEstimate(0.05, 0.001)) == pytest.approx(0.1)
