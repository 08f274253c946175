"""The measures on clouds whose values are known, and on the published noisy rows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pcdnf.errors import PcdnfError
from pcdnf.metrics import chamfer_distance, normal_error, point_to_surface, score

# Corners of a 3 x 4 rectangle (diagonal 5) and of the same one lifted by 0.5, a tenth of the diagonal.
CORNERS = np.array([[0.0, 0, 0], [3, 0, 0], [0, 4, 0], [3, 4, 0]])
LIFTED = CORNERS + np.array([0, 0, 0.5])
UP = np.tile([0.0, 0, 1], (4, 1))


def test_a_cloud_against_itself_scores_zero() -> None:
    scores = score(CORNERS, UP, CORNERS, -UP)
    assert (scores.chamfer_distance, scores.point_to_surface, scores.points) == (0, 0, 4)
    assert scores.normal_mean == scores.normal_rms == 0


@pytest.mark.parametrize("unit", [1.0, 1e-3, 1e6])
def test_values_by_hand_in_any_unit(unit: float) -> None:
    shift = np.array([4e5, 0, 0]) * unit
    lifted, corners = LIFTED * unit + shift, CORNERS * unit + shift
    assert chamfer_distance(lifted, corners) == pytest.approx((0.1**2 + 0.1**2) * 1e5)
    assert point_to_surface(lifted, corners, UP) == pytest.approx(0.1 * 1e3)


def test_tangential_noise_costs_no_distance_to_the_surface() -> None:
    moved = CORNERS + np.array([0.5, 0, 0])
    assert point_to_surface(moved, CORNERS, UP) == pytest.approx(0, abs=1e-9)
    assert chamfer_distance(moved, CORNERS) == pytest.approx(2e3)


def test_chamfer_distance_counts_what_is_missing() -> None:
    assert chamfer_distance(CORNERS[:3], CORNERS) == pytest.approx((3 / 5) ** 2 / 4 * 1e5)
    assert chamfer_distance(CORNERS, CORNERS[:3]) == pytest.approx((3 / 5) ** 2 / 4 * 1e5)


def test_normal_error_is_up_to_sign_and_length() -> None:
    tilted = np.array([[0, 0, 2.0], [0, 0, -1], [1, 0, 1], [-3, 0, 0]])
    mean, rms = normal_error(CORNERS, tilted, CORNERS, UP)
    assert mean == pytest.approx((45 + 90) / 4)
    assert rms == pytest.approx(np.sqrt((45**2 + 90**2) / 4))


def test_clean_normals_are_estimated_where_none_are_given() -> None:
    rng = np.random.default_rng(0)
    plane = np.c_[rng.uniform(size=(400, 2)), np.zeros(400)]
    lifted = plane + np.array([0, 0, 0.01])
    scores = score(lifted, np.tile([0.0, 0, 1], (400, 1)), plane)
    diagonal = np.linalg.norm(np.ptp(plane, axis=0))
    assert scores.point_to_surface == pytest.approx(10 / diagonal, rel=1e-6)
    assert scores.normal_mean == pytest.approx(0, abs=0.01)
    assert score(lifted, None, plane).normal_mean is None


def test_arrays_that_do_not_fit() -> None:
    for points, normals, clean, code in (
        (CORNERS.T, None, CORNERS, "bad_shape"),
        (CORNERS, UP[:3], CORNERS, "bad_shape"),
        (CORNERS, None, CORNERS[:0], "bad_shape"),
        (CORNERS, None, CORNERS[:1], "zero_extent"),
    ):
        with pytest.raises(PcdnfError) as caught:
            score(points, normals, clean)
        assert caught.value.code == code


@pytest.mark.parametrize(("name", "chamfer", "surface"), [("fandisk", 3.59, 3.92), ("boxunion", 3.77, 3.89)])
def test_the_published_noisy_rows(shared_data: Path, name: str, chamfer: float, surface: float) -> None:
    clean, noisy = np.load(shared_data / f"{name}.npy"), np.load(shared_data / f"{name}_noise0.5.npy")
    scores = score(noisy, None, clean)
    assert scores.chamfer_distance == pytest.approx(chamfer, abs=0.006)
    assert scores.point_to_surface == pytest.approx(surface, abs=0.006)


def test_a_published_row_with_given_normals(shared_data: Path) -> None:
    with np.load(shared_data / "bunny.npz") as bunny:
        clean, normals = bunny["points"], bunny["normals"]
    noisy = clean + np.random.default_rng(0).normal(size=clean.shape) * 0.5 / 100
    scores = score(noisy, None, clean, normals)
    assert scores.chamfer_distance == pytest.approx(3.55, abs=0.006)
    assert scores.point_to_surface == pytest.approx(3.94, abs=0.006)
