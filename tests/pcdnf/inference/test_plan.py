import numpy as np
import pytest

from pcdnf.geometry.recipe import Recipe
from pcdnf.inference.plan import Plan, make_plan
from pcdnf.inference.unit_frame import UnitFrame
from tests.support.clouds import noisy_sphere

ADAPTIVE = Recipe(points=256, adaptive=9.8, fewest=48, later=0.8)


def plan(points: np.ndarray, **choices: float | str) -> Plan:
    return make_plan(points, ADAPTIVE, frame=UnitFrame.of(points), **choices)  # type: ignore[arg-type]


def test_more_noise_takes_a_larger_radius_and_more_iterations() -> None:
    clean, usual, heavy = (plan(noisy_sphere(40_000, noise)) for noise in (0, 0.03, 0.2))
    assert [len(each.radii) for each in (clean, usual, heavy)] == [1, 2, 3]
    assert clean.radii[0] < usual.radii[0] < heavy.radii[0]
    assert usual.radii[1] == pytest.approx(0.8 * usual.radii[0])
    assert usual.radii[0] == pytest.approx(9.8 * np.sqrt(usual.scale.noise * usual.scale.spacing))


def test_the_radius_does_not_outgrow_the_shape() -> None:
    """As far as the noise asks; a sparse cloud's ball must hold points all the same."""
    points = noisy_sphere(40_000, 0.2)
    assert plan(points).radii[0] == pytest.approx(0.07 * UnitFrame.of(points).diagonal)
    sparse = noisy_sphere(400, 0.2)
    assert plan(sparse).radii[0] > 0.1 * UnitFrame.of(sparse).diagonal


def test_sparser_clouds_get_a_larger_radius_that_holds_enough_points() -> None:
    dense, sparse = plan(noisy_sphere(40_000, 0)), plan(noisy_sphere(2000, 0))
    assert sparse.radii[0] > 2 * dense.radii[0]
    points = noisy_sphere(2000, 0)
    inside = (np.linalg.norm(points - points[0], axis=1) < sparse.radii[0]).sum()
    assert 30 < inside < 80


def test_a_dense_cloud_gets_a_fuller_ball_than_the_fewest() -> None:
    """The steps of a depth camera would pass for clean surface otherwise."""
    points = noisy_sphere(40_000, 0.0)
    radius = plan(points).radii[0]
    assert 100 < (np.linalg.norm(points - points[0], axis=1) < radius).sum() < 250
    assert radius <= 0.04 * UnitFrame.of(points).diagonal * (1 + 1e-9)


def test_a_part_of_a_scene_gets_the_radius_of_the_scene() -> None:
    """Unlike a share of the diagonal."""
    points = noisy_sphere(40_000, 0.02)
    half = points[points[:, 0] > 0.5]
    assert plan(half).radii[0] == pytest.approx(plan(points).radii[0], rel=0.15)


def test_what_the_caller_gives_is_taken() -> None:
    points = 100 * noisy_sphere(3000, 0.01)
    assert plan(points, iterations=3, radius=7.5).radii == pytest.approx((7.5, 7.5, 7.5))
    share = plan(points, iterations="1", radius="4%")
    assert share.radii == pytest.approx((0.04 * UnitFrame.of(points).diagonal,))


def test_copies_of_one_point_get_a_radius_all_the_same() -> None:
    points = np.repeat(noisy_sphere(20, 0.0), 200, axis=0)
    assert plan(points).radii[0] > 0


def test_a_recipe_of_fixed_radius_keeps_it() -> None:
    points = noisy_sphere(3000, 0.01)
    fixed = make_plan(points, Recipe(radius=0.05), frame=UnitFrame.of(points), iterations=2)
    assert fixed.radii == pytest.approx((0.05 * UnitFrame.of(points).diagonal,) * 2)


def test_a_plan_survives_json_and_is_told() -> None:
    chosen = plan(noisy_sphere(3000, 0.01))
    assert Plan.from_json(chosen.to_json()) == chosen
    told = chosen.metadata()
    assert int(told["iterations"]) == chosen.iterations
    assert float(told["estimated_noise"]) == pytest.approx(chosen.scale.noise, rel=1e-3)
    assert [float(radius) for radius in told["radius"].split(", ")] == pytest.approx(chosen.radii, rel=1e-5)
