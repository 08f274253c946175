"""Whole runs that treat each point by the noise around it."""

import numpy as np
import pytest

from pcdnf import Denoiser
from pcdnf.inference.diagnostics import FARTHEST
from pcdnf.inference.plan import Plan
from tests.support.clouds import noisy_sphere


@pytest.fixture(scope="module")
def lite() -> Denoiser:
    return Denoiser.load("pcdnf-lite", device="cpu", precision="float32")


def off(points: np.ndarray) -> float:
    """Mean distance to the unit sphere."""
    return float(np.abs(np.linalg.norm(points, axis=1) - 1).mean())


def test_copies_count_once_and_stay_together(lite: Denoiser) -> None:
    points = noisy_sphere(1500, 0.01)
    alone = off(lite.denoise(points).points)
    order = np.random.default_rng(0).permutation(6000)
    result = lite.denoise(np.repeat(points, 4, axis=0)[order])
    back = np.empty((6000, 3))
    back[order] = result.points
    copies = back.reshape(1500, 4, 3)
    assert np.array_equal(copies, np.repeat(copies[:, :1], 4, axis=1))
    assert off(result.points) == pytest.approx(alone, rel=0.05)


def test_rows_of_zeros_stay_and_change_nothing(lite: Denoiser) -> None:
    points = noisy_sphere(1500, 0.01) + np.array([3.0, 0, 0])
    holes = np.insert(points, np.arange(0, 1500, 3), 0, axis=0)
    result = lite.denoise(holes)
    void = ~holes.any(1)
    assert void.sum() == 500
    assert not result.points[void].any()
    assert np.isfinite(result.normals).all()
    assert np.abs(result.points[~void] - lite.denoise(points).points).max() < 1e-9
    assert result.diagnostics is not None
    assert not result.diagnostics.noise[void].any()


def test_no_point_goes_further_than_its_noise_explains(lite: Denoiser) -> None:
    points = noisy_sphere(3000, 0.01)
    points[:60] *= 1.15  # far outside of the noise
    result = lite.denoise(points, iterations=2)
    found = result.diagnostics
    assert found is not None
    assert (found.displacement <= FARTHEST * found.noise * (1 + 1e-6)).all()
    assert (found.displacement[60:] > 0).mean() > 0.98
    assert set(found.metadata().items()) <= set(result.metadata.items())
    assert off(result.points[60:]) < 0.4 * off(points[60:])


def test_noise_far_below_the_spacing_does_no_harm(lite: Denoiser) -> None:
    """A stair of a sparse scan: its steps are no longer than a few spacings."""
    rng = np.random.default_rng(0)
    flat = rng.uniform(0, 4, (5000, 2))
    height = np.where(flat[:, 0] < 2, 0, 0.2 * np.floor(4 * (flat[:, 0] - 2)))
    points = np.c_[flat, height + 0.001 * rng.normal(size=5000)]
    before, after = (np.abs(each[:, 2] - height) for each in (points, lite.denoise(points).points))
    assert after.mean() < 0.85 * before.mean()
    assert (after > before + 0.001).mean() < 0.01


def test_a_clean_cloud_stays(lite: Denoiser) -> None:
    points = noisy_sphere(4000, 0)
    assert np.abs(lite.denoise(points).points - points).max() < 1e-3


def test_both_sides_of_a_thin_wall_stay_apart(lite: Denoiser) -> None:
    rng = np.random.default_rng(1)
    side = rng.choice([-1.0, 1.0], 4000)
    for gap in (0.012, 0.04):
        wall = np.c_[rng.uniform(0, 1, (4000, 2)), side * gap / 2 + 0.002 * rng.normal(size=4000)]
        for normals in (None, np.c_[np.zeros((4000, 2)), side]):
            height = lite.denoise(wall, normals).points[:, 2] * side
            assert 2 * height.mean() > 0.8 * gap
            assert np.sqrt(((height - gap / 2) ** 2).mean()) < 1.3 * 0.002


def test_what_else_is_in_the_file_changes_little(lite: Denoiser) -> None:
    points = noisy_sphere(4000, 0.02)
    alone = off(lite.denoise(points).points)
    far = np.random.default_rng(2).normal(size=(40, 3)) * 100
    assert off(lite.denoise(np.r_[points, far]).points[:4000]) == pytest.approx(alone, rel=0.03)


def test_a_plan_says_whether_it_is_local_and_one_of_older_jobs_is_not(lite: Denoiser) -> None:
    points = noisy_sphere(2000, 0.02)
    plan = lite.plan(points)
    assert plan.local
    assert Plan.from_json(plan.to_json()) == plan
    old = {key: value for key, value in plan.to_json().items() if key != "local"}
    assert not Plan.from_json(old).local
    assert lite.prepare(points, plan=Plan.from_json(old)).local is None
    given = lite.denoise(points, radius=0.3)
    assert given.diagnostics is not None
    assert len(np.unique(given.diagnostics.noise)) == 1
