"""Colours and intensity on their way between formats."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest

from pcdnf.formats import PointCloud, read, write
from pcdnf.formats.colours import colours_of, sixteen_bit_intensity

EIGHT = np.array([[255, 0, 128], [1, 2, 3], [254, 100, 0]])
POINTS = np.random.default_rng(0).normal(size=(3, 3))
KINDS = {
    "8 bits": EIGHT.astype(np.uint8),
    "8 bits times 257": (EIGHT * 257).astype(np.uint16),
    "8 bits times 256": (EIGHT * 256).astype(np.uint16),
    "floats to 1": (EIGHT / 255).astype(np.float32),
    "doubles to 1": EIGHT / 255,
    "floats to 255": EIGHT.astype(np.float32),
}


def coloured(table: np.ndarray[Any, Any], names: tuple[str, ...] = ("red", "green", "blue")) -> PointCloud:
    return PointCloud(points=POINTS, attributes=dict(zip(names, table.T, strict=True)))


@pytest.mark.parametrize("kind", KINDS)
def test_colours_of_every_kind_are_full_in_las_and_exact_in_pcd(tmp_path: Path, kind: str) -> None:
    assert write(tmp_path / "a.las", coloured(KINDS[kind]), format="las") == []
    las = laspy.read(tmp_path / "a.las")
    np.testing.assert_array_equal(np.stack([las.red, las.green, las.blue], axis=1), EIGHT * 257)
    write(tmp_path / "a.pcd", coloured(KINDS[kind], ("r", "g", "b")), format="pcd")
    again = read(tmp_path / "a.pcd")
    np.testing.assert_array_equal(np.stack([again.attributes[name] for name in ("red", "green", "blue")], 1), EIGHT)
    assert b"TYPE F F F F\n" in (tmp_path / "a.pcd").read_bytes(), "as PCL packs colours"


def test_colours_that_lose_bits_are_said(tmp_path: Path) -> None:
    deep = coloured(np.array([[65535, 0, 1], [300, 2, 3], [5, 6, 7]], np.uint16))
    for ending in ("pcd", "e57"):
        notes = write(tmp_path / "a", deep, format=ending)
        assert any("8 bits" in note for note in notes), ending


def test_columns_that_are_no_colours_stay_what_they_are() -> None:
    assert colours_of({"red": np.array([-1]), "green": np.array([2]), "blue": np.array([3])}) is None
    assert colours_of({"red": np.array([1e9]), "green": np.array([2]), "blue": np.array([3])}) is None
    assert colours_of({"red": np.zeros((1, 2)), "green": np.zeros(1), "blue": np.zeros(1)}) is None


def test_intensity_of_floats_becomes_sixteen_bits(tmp_path: Path) -> None:
    values, how = sixteen_bit_intensity(np.array([0, 0.5, 1], np.float32))
    assert values is not None
    assert values.tolist() == [0, 32768, 65535]
    assert "0..65535" in how
    values, how = sixteen_bit_intensity(np.array([0, 7.0, 40000, np.nan]))
    assert values is not None
    assert (values.tolist(), how) == ([0, 7, 40000, 0], "NaN and infinity became 0")
    assert sixteen_bit_intensity(np.array([-2048, 5]))[0] is None
    cloud = PointCloud(points=POINTS, attributes={"scalar_Intensity": np.array([0, 5, 9], np.float32)})
    assert write(tmp_path / "a.las", cloud, format="las") == []
    assert laspy.read(tmp_path / "a.las").intensity.tolist() == [0, 5, 9]
