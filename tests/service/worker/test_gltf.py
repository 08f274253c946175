from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pcdnf.formats import PointCloud
from service.worker import gltf as display
from service.worker.gltf import BINS, colours, write_display
from tests.support.display_file import read_display

Array = NDArray[Any]


def _written(path: Path, before: Array, after: Array, colour: Array | None = None) -> Any:
    normals = np.tile(np.array([0, 0.6, -0.8], np.float32), (len(before), 1))
    write_display(path, before=before, after=after, raw_normals=-normals, normals=normals, colour=colour)
    return read_display(path)


def test_one_order_for_all_and_centred_coordinates(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    before = random.uniform(-50, 50, (5000, 3)) + np.array([443_210.25, 4_480_000.125, 812.5])
    after = before + np.array([0.3, 0, 0.4]) * random.uniform(0, 1, (5000, 1))
    colour = random.integers(0, 256, (5000, 3)).astype(np.uint8)
    document, meshes = _written(tmp_path / "a", before, after, colour)
    centre = np.array(document["asset"]["extras"]["centre"])
    rows = np.random.default_rng(0).permutation(5000)
    assert meshes["before"]["POSITION"].dtype == np.float32
    np.testing.assert_allclose(meshes["before"]["POSITION"], before[rows] - centre, atol=1e-5)
    np.testing.assert_allclose(meshes["after"]["POSITION"], after[rows] - centre, atol=1e-5)
    np.testing.assert_allclose(meshes["after"]["_DISPLACEMENT"], np.linalg.norm((after - before)[rows], axis=1), 1e-5)
    np.testing.assert_array_equal(meshes["before"]["COLOR_0"][:, :3], colour[rows])
    assert (meshes["before"]["COLOR_0"][:, 3] == 255).all()
    np.testing.assert_allclose(meshes["after"]["NORMAL"][0, :3] / 127, [0, 0.6, -0.8], atol=0.005)
    np.testing.assert_array_equal(meshes["before"]["NORMAL"], -meshes["after"]["NORMAL"])
    _written(tmp_path / "b", before, after, colour)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_numbers_are_of_the_whole_cloud_while_few_points_are_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(display, "DISPLAY_POINTS", 100)
    before = np.zeros((10_001, 3))
    before[:, 0] = np.linspace(-1, 1, 10_001)
    after = before.copy()
    after[:, 2] = np.linspace(0, 2, 10_001)
    document, meshes = _written(tmp_path / "a", before, after)
    extras = document["asset"]["extras"]
    assert extras["points"] == 10_001
    assert {len(array) for mesh in meshes.values() for array in mesh.values()} == {100}
    assert "COLOR_0" not in meshes["before"]
    moved = extras["displacement"]
    assert [moved[key] for key in ("mean", "median", "p95", "p99", "max")] == pytest.approx([1, 1, 1.9, 1.98, 2])
    assert len(moved["histogram"]) == BINS
    assert sum(moved["histogram"]) == pytest.approx(0.99 * 10_001, abs=2)
    assert extras["box"] == pytest.approx(np.array([[-0.98, 0, 0], [0.98, 0, 0]]))


def test_shares_of_what_was_done_come_along(tmp_path: Path) -> None:
    points = np.random.default_rng(0).normal(size=(50, 3))
    shares = {"moved": 0.5, "left": 0.5, "doubtful": 0.02}
    write_display(
        tmp_path / "a", before=points, after=points, raw_normals=points, normals=points, colour=None, shares=shares
    )
    assert read_display(tmp_path / "a")[0]["asset"]["extras"]["shares"] == shares
    document, _ = _written(tmp_path / "b", points, points)
    assert "shares" not in document["asset"]["extras"]


def test_points_that_did_not_move(tmp_path: Path) -> None:
    points = np.random.default_rng(0).normal(size=(50, 3))
    document, _ = _written(tmp_path / "a", points, points)
    moved = document["asset"]["extras"]["displacement"]
    assert moved["p99"] == moved["mean"] == 0
    assert moved["histogram"][0] == 50


@pytest.mark.parametrize(
    ("attributes", "expected"),
    [
        ({"red": [1, 2], "green": [3, 4], "blue": [5, 6]}, [[1, 3, 5], [2, 4, 6]]),
        ({"r": [0.0, 1.0], "g": [0.5, 0.5], "b": [0.0, np.nan]}, [[0, 128, 0], [255, 128, 0]]),
        ({"r": [0.0, 200.4], "g": [0.0, 1.0], "b": [0.0, 300.0]}, [[0, 0, 0], [200, 1, 255]]),
        ({"colors": [[257, 0, 65535], [0, 0, 514]]}, [[1, 0, 255], [0, 0, 2]]),
        ({"rgb": [[1.0, 0.0, 0.2, 0.5], [0.0, 0.0, 0.0, 1.0]]}, [[255, 0, 51], [0, 0, 0]]),
        ({"red": [1, 2], "green": [3, 4]}, None),
        ({"colors": [["a", "b", "c"]] * 2}, None),
        ({}, None),
    ],
)
def test_colours(attributes: dict[str, Any], expected: list[list[int]] | None) -> None:
    columns = {name: np.array(values) for name, values in attributes.items()}
    if "red" in columns:
        columns = {name: column.astype(np.uint8) for name, column in columns.items()}
    found = colours(PointCloud(points=np.zeros((2, 3)), attributes=columns))
    assert (None if found is None else found.tolist()) == expected
    assert found is None or found.dtype == np.uint8
