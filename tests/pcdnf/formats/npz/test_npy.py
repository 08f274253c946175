"""Bare arrays, and arrays with named fields."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pcdnf.formats import FormatError, Limits, read, write

POINTS = np.random.default_rng(0).normal(size=(20, 3))
KIND = [
    ("X", ">f4"),
    ("Y", ">f4"),
    ("Z", ">f4"),
    ("Nx", "f4"),
    ("Ny", "f4"),
    ("Nz", "f4"),
    ("hits", "u2"),
    ("pair", "i4", (2,)),
]


def table() -> np.ndarray[Any, Any]:
    rows = np.zeros(20, KIND)
    for axis, name in enumerate("XYZ"):
        rows[name] = POINTS[:, axis]
    rows["Nz"], rows["hits"], rows["pair"] = 1, np.arange(20), np.arange(40).reshape(20, 2)
    return rows


@pytest.mark.parametrize("name", ["a.npy", "a.npz"])
def test_an_array_with_named_fields(tmp_path: Path, name: str) -> None:
    (np.save if name == "a.npy" else np.savez)(tmp_path / name, table())
    cloud = read(tmp_path / name)
    np.testing.assert_array_equal(cloud.points, POINTS.astype(np.float32))
    np.testing.assert_array_equal(cloud.normals, np.tile([0, 0, 1], (20, 1)))  # type: ignore[arg-type]
    assert cloud.attributes["hits"].tolist() == list(range(20))
    assert cloud.attributes["pair"].shape == (20, 2)
    assert "named fields" in cloud.warnings[0]
    write(tmp_path / "b.npz", cloud, check=True)
    assert sorted(np.load(tmp_path / "b.npz")) == ["hits", "normals", "pair", "points"]


@pytest.mark.parametrize("order", ["C", "F"])
def test_a_bare_array(tmp_path: Path, order: Any) -> None:
    np.save(tmp_path / "a.npy", np.asarray(np.column_stack([POINTS, np.arange(20)]), order=order))
    cloud = read(tmp_path / "a.npy")
    np.testing.assert_array_equal(cloud.points, POINTS)
    assert cloud.attributes["column_4"].tolist() == list(range(20))
    np.save(tmp_path / "b.npy", (POINTS * 100).astype(np.int32))
    assert read(tmp_path / "b.npy").points.dtype == np.float64


@pytest.mark.parametrize(
    ("array", "code"),
    [
        (np.zeros((20, 2)), "bad_shape"),
        (np.zeros(20), "bad_shape"),
        (np.array([{}] * 4, object), "unsupported_dtype"),
        (np.zeros(4, [("x", "f4"), ("y", "f4")]), "bad_shape"),
        (np.zeros(4, [("x", "f4"), ("y", "f4"), ("z", "O")]), "unsupported_dtype"),
        (np.zeros(4, [("x", "f4"), ("y", "f4"), ("z", "f4", (2,))]), "bad_shape"),
    ],
)
def test_refusals(tmp_path: Path, array: np.ndarray[Any, Any], code: str) -> None:
    np.save(tmp_path / "a.npy", array, allow_pickle=True)
    with pytest.raises(FormatError) as caught:
        read(tmp_path / "a.npy")
    assert caught.value.code == code


def test_a_bare_array_that_is_cut_or_large(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", POINTS)
    with pytest.raises(FormatError) as caught:
        read(tmp_path / "a.npy", limits=Limits(max_points=19))
    assert caught.value.code == "too_many_points"
    data = (tmp_path / "a.npy").read_bytes()
    (tmp_path / "a.npy").write_bytes(data[:-5])
    with pytest.raises(FormatError) as caught:
        read(tmp_path / "a.npy")
    assert caught.value.code == "truncated"


def test_what_is_not_read_says_what_to_do(tmp_path: Path) -> None:
    for data, word in ((b"glTF\2\0\0\0", "GLB"), (b"solid a\n", "STL"), (b"OFF\n3 1 0\n", "OFF")):
        (tmp_path / "a").write_bytes(data)
        with pytest.raises(FormatError, match=word) as caught:
            read(tmp_path / "a")
        assert "PLY" in str(caught.value.hint)


def test_members_as_open3d_names_them(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    positions, colours = rng.normal(size=(30, 3)), rng.integers(0, 256, (30, 3)).astype(np.uint8)
    intensities = rng.random((30, 1))
    np.savez(tmp_path / "a.npz", positions=positions, normals=np.ones((30, 3)), colors=colours, intensities=intensities)
    cloud = read(tmp_path / "a.npz")
    np.testing.assert_array_equal(cloud.points, positions)
    assert cloud.normals is not None
    write(tmp_path / "b.npz", cloud.replaced(positions + 1, -np.ones((30, 3))))
    with np.load(tmp_path / "b.npz") as found:
        np.testing.assert_array_equal(found["positions"], positions + 1)
        np.testing.assert_array_equal(found["normals"], -np.ones((30, 3)))
        np.testing.assert_array_equal(found["colors"], colours)
        np.testing.assert_array_equal(found["intensities"], intensities)
        assert "points" not in found
    for ending in ("ply", "pcd", "las", "e57"):
        write(tmp_path / f"b.{ending}", cloud, format=ending, check=True)
        again = read(tmp_path / f"b.{ending}").attributes["red"]
        np.testing.assert_array_equal(again // (257 if ending == "las" else 1), colours[:, 0], ending)
