"""Flying pixels in small depth images: a board before a wall, with a wire and a floor seen at a slant."""

from __future__ import annotations

import numpy as np

from pcdnf.geometry.flying_pixels import flying_pixels
from tests.support.clouds import depth_image


def test_flying_pixels_are_found_and_wires_boards_and_slanted_floors_stay() -> None:
    points, kinds = depth_image()
    found = flying_pixels(points, np.zeros((len(points), 3)))
    assert found[kinds["flying"]].mean() > 0.9
    assert not found[kinds["wire"]].any()
    assert found[kinds["rest"]].mean() < 0.002


def test_each_scanner_counts_by_itself() -> None:
    points, kinds = depth_image()
    shift = np.array([3.0, 0.5, -1.0])
    both = np.concatenate([points, points + shift])
    sensors = np.repeat([np.zeros(3), shift], len(points), axis=0)
    alone = flying_pixels(points, np.zeros((len(points), 3)))
    np.testing.assert_array_equal(flying_pixels(both, sensors), np.tile(alone, 2))
    wrong = flying_pixels(both, np.zeros((len(both), 3)))
    assert wrong[np.tile(kinds["rest"], 2)].sum() > 10 * alone[kinds["rest"]].sum()


def test_points_of_unknown_scanners_and_of_few_points_are_not_judged() -> None:
    points, _ = depth_image()
    assert not flying_pixels(points, np.full((len(points), 3), np.nan)).any()
    assert not flying_pixels(points[:30], np.zeros((30, 3))).any()
