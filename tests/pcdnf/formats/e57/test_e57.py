"""E57: against pye57, scans and poses, and one test for each way a file can be wrong."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pye57
import pytest

from pcdnf.formats import E57Flavour, FormatError, Limits, PointCloud, read, write

COUNT = 60
TURN = np.array([np.sqrt(0.5), 0, 0, np.sqrt(0.5)])  # a quarter turn about z
SHIFT = np.array([1000.0, 2000.0, 30.0])
Refused = Callable[..., FormatError]


def station(path: Path, *, scans: int = 2, **more: Any) -> list[np.ndarray[Any, Any]]:
    """A file of pye57's; the local coordinates of each scan."""
    rng = np.random.default_rng(0)
    local = [rng.normal(size=(COUNT, 3)).astype(np.float32).astype(np.float64) for _ in range(scans)]
    with pye57.E57(str(path), mode="w") as file:
        for number, points in enumerate(local):
            data = {f"cartesian{axis}": points[:, index].copy() for index, axis in enumerate("XYZ")}
            data["intensity"] = np.linspace(0, 1, COUNT).astype(np.float32)
            data |= {name: np.arange(COUNT, dtype=np.uint8) for name in ("colorRed", "colorGreen", "colorBlue")}
            file.write_scan_raw(data | more, name=f"Station {number}", rotation=TURN, translation=SHIFT * number)
    return local


def test_scans_stand_in_one_frame_and_go_back_into_theirs(tmp_path: Path) -> None:
    local = station(tmp_path / "a.e57")
    cloud = read(tmp_path / "a.e57")
    expected = [np.c_[-points[:, 1], points[:, 0], points[:, 2]] + SHIFT * n for n, points in enumerate(local)]
    np.testing.assert_allclose(cloud.points, np.concatenate(expected), atol=1e-9)
    assert [*cloud.attributes] == ["intensity", "red", "green", "blue", "scan_index"]
    np.testing.assert_array_equal(cloud.attributes["scan_index"], np.repeat([0, 1], COUNT))
    normals = np.tile([0.0, 0.6, 0.8], (2 * COUNT, 1)).astype(np.float32)
    moved = cloud.points + np.array([0.5, 0, 0])
    result = cloud.replaced(moved, normals, metadata={"seed": "0"})
    assert write(tmp_path / "b.e57", result) == []
    again = read(tmp_path / "b.e57")
    np.testing.assert_allclose(again.points, moved, atol=1e-9)
    np.testing.assert_allclose(again.normals, normals, atol=1e-6)
    for name, column in cloud.attributes.items():
        np.testing.assert_array_equal(again.attributes[name], column)
        assert again.attributes[name].dtype == column.dtype
    assert again.metadata == {"seed": "0"}
    with pye57.E57(str(tmp_path / "b.e57")) as file:
        assert file.scan_count == 2
        header = file.get_header(1)
        np.testing.assert_allclose(header.translation, SHIFT)
        np.testing.assert_allclose(header.rotation, TURN)
        assert header["name"].value() == "Station 1"
        raw = file.read_scan_raw(1, ignore_unsupported_fields=True)
        np.testing.assert_allclose(raw["cartesianY"], local[1][:, 1] - 0.5, atol=1e-9)
    write(tmp_path / "c.e57", result)
    assert (tmp_path / "c.e57").read_bytes() == (tmp_path / "b.e57").read_bytes()


def test_points_marked_invalid_are_holes(tmp_path: Path) -> None:
    state = np.zeros(COUNT, np.int8)
    state[7] = 1
    station(tmp_path / "a.e57", scans=1, cartesianInvalidState=state)
    with pytest.raises(FormatError) as caught:
        read(tmp_path / "a.e57", limits=Limits(nonfinite="reject"))
    assert (caught.value.code, caught.value.actual) == ("nonfinite", 1)
    cloud = read(tmp_path / "a.e57", limits=Limits(nonfinite="drop"))
    assert cloud.dropped.tolist() == [7]
    assert any("1 points have a direction but no distance" in warning for warning in cloud.warnings)
    assert "scan_index" not in cloud.attributes


def test_from_and_to_other_formats(tmp_path: Path) -> None:
    points = np.random.default_rng(0).normal(size=(COUNT, 3)) + np.array([500_000, 4_480_000, 0])
    cloud = PointCloud(
        points=points,
        attributes={
            **{name: np.arange(COUNT, dtype=np.uint8) for name in ("red", "green", "blue")},
            "intensity": np.arange(COUNT, dtype=np.uint16),
            "label": np.arange(COUNT),
        },
        comments=["a comment"],
    )
    notes = write(tmp_path / "a", cloud, format="e57")
    assert ["comments" in notes[0], "'label'" in notes[1], len(notes)] == [True, True, 2]
    again = read(tmp_path / "a")
    assert isinstance(again.flavour, E57Flavour)
    np.testing.assert_array_equal(again.points, points)
    np.testing.assert_array_equal(again.attributes["intensity"], cloud.attributes["intensity"])
    assert write(tmp_path / "b", again, format="ply") == []
    np.testing.assert_array_equal(read(tmp_path / "b").attributes["blue"], np.arange(COUNT))


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("e57") / "a.e57"
    station(path)
    return path.read_bytes()


@pytest.mark.parametrize(
    ("at", "form", "value", "code"),
    [
        (8, "<I", 2, "bad_header"),
        (16, "<Q", 2**60, "truncated"),
        (16, "<Q", 1024, "trailing_data"),
        (24, "<Q", 2**60, "truncated"),
        (24, "<Q", 1021, "truncated"),
        (32, "<Q", 2**60, "header_too_long"),
        (32, "<Q", 10, "bad_header"),
        (40, "<Q", 512, "bad_header"),
    ],
)
def test_headers_that_lie(refused: Refused, data: bytes, at: int, form: str, value: int, code: str) -> None:
    changed = bytearray(data)
    struct.pack_into(form, changed, at, value)
    assert refused(bytes(changed)).code == code


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        (b'recordCount="60"', b'recordCount="6\xff"', "bad_header"),
        (b'recordCount="60"', b'recordCount="-1"', "bad_header"),
        (b'recordCount="60"', b'recordCount="61"', "corrupt_archive"),
        (b"cartesianX", b"cartesianW", "missing_coordinates"),
        (b"colorRed", b"colorBlue"[:8], "bad_header"),
        (b"<w ", b"<v ", "bad_header"),
        (b"<?xml version", b"<!DOCTYPE xml", "bad_header"),
        (b'"Float"', b'"Flaot"', "bad_header"),
    ],
)
def test_xml_that_lies(refused: Refused, data: bytes, old: bytes, new: bytes, code: str) -> None:
    assert old in data
    assert refused(data.replace(old, new)).code in (code, "bad_header", "corrupt_archive")


def test_cut_and_damaged(refused: Refused, data: bytes) -> None:
    for length in (8, 47, 1024, len(data) - 1):
        assert refused(data[:length]).code == "truncated"
    assert refused(data + bytes(1024)).code == "trailing_data"
    damaged = bytearray(data)
    damaged[200] ^= 1
    assert refused(bytes(damaged)).code == "corrupt_archive", "the checksum of a page"


def test_limits_of_points(refused: Refused, data: bytes) -> None:
    assert refused(data, max_points=2 * COUNT - 1).code == "too_many_points"
    assert refused(data, minimum_points=2 * COUNT + 1).code == "too_few_points"


def test_without_its_library(refused: Refused, data: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pcdnf.file_formats.importlib.util.find_spec", lambda _: None)
    error = refused(data)
    assert error.code == "missing_extra"
    assert "pcdnf[e57]" in str(error.hint)


def test_each_cloud_has_an_identifier_of_its_own_and_the_same_every_time(tmp_path: Path) -> None:
    def identifier(points: np.ndarray[Any, Any]) -> str:
        write(tmp_path / "a.e57", PointCloud(points=points), format="e57")
        with pye57.E57(str(tmp_path / "a.e57")) as file:
            return str(file.root["guid"].value())

    points = np.random.default_rng(0).normal(size=(200, 3))
    other = points.copy()
    other[199, 2] += 1e-9
    assert identifier(points) == identifier(np.asfortranarray(points)) != identifier(other)
