"""Pictures: what is seen where, in which colour, from which side."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from pcdnf.formats import PointCloud
from pcdnf.render.camera import Camera, automatic, looking
from pcdnf.render.panels import render_comparison
from pcdnf.render.splats import draw, visible

FRONT = Camera(np.eye(3), np.zeros(3), 4.0)
BLACK = np.zeros((60, 80, 3), np.float32)


def sphere(count: int = 3000, noise: float = 0.0) -> NDArray[np.float64]:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(count, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True) + rng.normal(size=(count, 3)) * noise


def pixels(path: Path) -> NDArray[np.float64]:
    with Image.open(path) as picture:
        return np.asarray(picture.convert("RGB"), np.float64)


def test_the_nearer_point_hides_the_other() -> None:
    points = np.array([[0, 0, 0.0], [0, 0, 1], [1, 0, 0]])
    facing = np.tile([0.0, 0, 1], (3, 1))
    index, depth = visible(points, facing, np.full(3, 0.05), FRONT, 60, 80)
    assert index[30, 40] == 1
    assert depth[30, 40] == pytest.approx(3)
    assert 2 in index
    assert 0 not in index
    assert index[0, 0] == -1


def test_discs_lie_in_their_tangent_planes() -> None:
    tilted = np.array([[np.sin(1.2), 0, np.cos(1.2)]])
    upright, _ = visible(np.zeros((1, 3)), np.array([[0, 0, 1.0]]), np.array([0.3]), FRONT, 200, 200)
    edge_on, depth = visible(np.zeros((1, 3)), tilted, np.array([0.3]), FRONT, 200, 200)
    rows, columns = np.nonzero(edge_on == 0)
    assert np.ptp(columns) < 0.5 * np.ptp(rows)
    assert np.ptp(np.nonzero(upright == 0)[0]) == np.ptp(rows)
    middle = depth[100, columns.min() : columns.max()]
    assert np.all(np.diff(middle) > 0), "the side the normal leans to is farther away"


def test_discs_partly_outside_the_picture_are_cut() -> None:
    points = np.array([[0.0, 0.95, 0], [40, 0, 0], [0, 0, 3.9]])
    facing = np.tile([0.0, 0, 1], (3, 1))
    index, _ = visible(points, facing, np.full(3, 0.3), FRONT, 60, 80)
    assert set(np.unique(index)) <= {-1, 0, 2}


def test_light_comes_from_the_upper_left_on_either_sign_of_a_normal() -> None:
    points = np.zeros((1, 3))
    lit = [
        draw(points, np.array([normal]) / np.linalg.norm(normal), None, np.array([0.2]), FRONT, 60, 80, BLACK)[
            30, 40
        ].sum()
        for normal in ([-1.0, 1, 1], [1, -1, -1], [1, -1, 1])
    ]
    assert lit[0] == pytest.approx(lit[1])
    assert lit[0] > 3 * lit[2]


def test_framing_fills_the_picture() -> None:
    points = sphere() * [3, 1, 1] + [1e6, 0, 0]
    camera = looking(np.array([0.0, 0, 1]), np.array([0.0, 1, 0]), points).framing(points, 2.0, 0.8)
    column, row, _ = camera.project(points, 100, 200)
    assert np.percentile(column, 98) - np.percentile(column, 2) == pytest.approx(160, rel=0.05)
    assert np.median(column) == pytest.approx(100, abs=8)
    assert np.median(row) == pytest.approx(50, abs=8)


def test_zooming_keeps_the_place_in_the_middle() -> None:
    points = np.array([[0.4, 0.3, 0.7]])
    column, row, _ = FRONT.project(points, 100, 100)
    near = FRONT.zoomed((column[0] - 50) / 100, (row[0] - 50) / 100, 5)
    np.testing.assert_allclose([part[0] for part in near.project(points, 100, 100)[:2]], [50, 50], atol=1e-9)


def test_a_scan_is_seen_from_its_sensor_and_a_statue_upright() -> None:
    scan = sphere() * 0.5 + [0, 0, 2]
    camera = automatic(scan, sphere())
    assert camera.axes[2] @ [0, 0, -1] > 0.85
    assert camera.axes[1] @ [0, -1, 0] > 0.85
    statue = sphere() * [1, 1, 3]
    assert automatic(statue, sphere()).axes[1] @ [0, 0, 1] > 0.85
    assert automatic(sphere(), sphere()).axes[1] @ [0, 1, 0] > 0.85


def test_a_comparison_shows_both_halves_from_one_side(tmp_path: Path) -> None:
    before, after = PointCloud(points=sphere(20_000, noise=0.03)), PointCloud(points=sphere(20_000))
    path = tmp_path / "picture.png"
    render_comparison(before, after, path, title="A sphere", size=(400, 220), inset=False)
    picture = pixels(path)
    assert picture.shape == (220, 400, 3)
    left, right = picture[60:200, :200].mean(axis=2), picture[60:200, 200:].mean(axis=2)
    roughness = [np.abs(np.diff(half[40:100, 70:130], axis=1)).mean() for half in (left, right)]
    assert roughness[0] > 2 * roughness[1]
    # label apart, both discs cover the same place
    overlap = (left > 90) & (right > 90)
    assert overlap.sum() > 0.7 * (right > 90).sum()


@pytest.mark.parametrize(
    "attributes",
    [
        {"red": np.full(3000, 255, "u1"), "green": np.zeros(3000, "u1"), "blue": np.zeros(3000, "u1")},
        {"rgb": np.tile(np.array([1.0, 0, 0], "f4"), (3000, 1))},
        {"colors": np.tile(np.array([65535, 0, 0, 65535], "u2"), (3000, 1))},
    ],
)
def test_own_colours_are_used(tmp_path: Path, attributes: dict[str, Any]) -> None:
    cloud = PointCloud(points=sphere(), attributes=attributes)
    path = tmp_path / "picture.png"
    render_comparison(cloud, cloud, path, size=(200, 100), inset=False)
    middle = pixels(path)[50, 50]
    assert middle[0] > 120
    assert middle[1:].max() < 20
    render_comparison(cloud, cloud, path, size=(200, 100), inset=False, coloured=False)
    assert pixels(path)[50, 50, 1] > 60


def test_the_inset_magnifies_the_same_place_twice(tmp_path: Path) -> None:
    cloud = PointCloud(points=sphere())
    render_comparison(cloud, cloud, tmp_path / "with.png", size=(400, 220), labels=("A", "A"))
    render_comparison(cloud, cloud, tmp_path / "without.png", size=(400, 220), labels=("A", "A"), inset=False)
    changed = np.abs(pixels(tmp_path / "with.png") - pixels(tmp_path / "without.png")).max(axis=2) > 30
    left, right = changed[:, :198], changed[:, 202:398]
    assert left.any()
    assert np.mean(left[:, 2:] != changed[:, 202:398]) < 0.2
    assert right.any()


@pytest.mark.parametrize("points", [sphere(1), sphere(2), np.outer(np.arange(9.0), [1, 2, 3]), np.zeros((5, 3))])
def test_degenerate_clouds_are_drawn(tmp_path: Path, points: NDArray[np.float64]) -> None:
    cloud = PointCloud(points=points)
    render_comparison(cloud, cloud, tmp_path / "picture.png", size=(160, 90))
    assert pixels(tmp_path / "picture.png").shape == (90, 160, 3)
