"""NPZ: what comes back, and one test for each way an archive can be wrong."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from pcdnf.formats import FormatError, NpzFlavour, PointCloud, read, write
from tests.support.npz_files import POINTS, npz

# What comes back


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_roles_attributes_and_extras(tmp_path: Path, save: Callable[..., None]) -> None:
    colours = np.arange(12, dtype=np.uint8).reshape(4, 3)
    path = tmp_path / "cloud.npz"
    save(
        path,
        colors=colours,
        points=POINTS,
        normals=-POINTS,
        intensity=np.ones(4, ">f2"),
        pose=np.eye(4)[:3],
        scale=np.float64(2),
    )
    cloud = read(path)
    np.testing.assert_array_equal(cloud.points, POINTS)
    np.testing.assert_array_equal(cloud.normals, -POINTS)
    assert list(cloud.attributes) == ["colors", "intensity"]
    assert list(cloud.extras) == ["pose", "scale"]
    write(path, cloud)
    with np.load(path, allow_pickle=False) as again:
        assert list(again) == ["colors", "points", "normals", "intensity", "pose", "scale"]
        assert again["intensity"].dtype == np.dtype(">f2")
        np.testing.assert_array_equal(again["colors"], colours)
        np.testing.assert_array_equal(again["pose"], np.eye(4)[:3])
        assert again["scale"].shape == ()
    with zipfile.ZipFile(path) as members:
        kinds = {info.compress_type for info in members.infolist()}
    assert kinds == {zipfile.ZIP_DEFLATED if save is np.savez_compressed else zipfile.ZIP_STORED}


@pytest.mark.parametrize("name", ["points", "xyz", "pos"])
@pytest.mark.parametrize("dtype", ["<f4", ">f4", "<f8", ">f8"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_names_types_and_orders_of_the_points(load: Any, tmp_path: Path, name: str, dtype: str, order: Any) -> None:
    cloud = load(npz(**{name: np.asarray(POINTS, dtype, order)}))
    np.testing.assert_array_equal(cloud.points, POINTS)
    assert cloud.points.dtype == np.dtype(dtype).newbyteorder("=")
    assert cloud.points.dtype.isnative
    write(tmp_path / "out.npz", cloud)
    with np.load(tmp_path / "out.npz") as again:
        assert again[name].dtype == np.dtype(dtype)


@pytest.mark.parametrize(
    ("dtype", "result"), [("<f2", "float32"), (">i2", "float64"), ("u1", "float64"), ("<u8", "float64")]
)
def test_halves_and_integers_come_back_as_floats_with_a_warning(load: Any, dtype: str, result: str) -> None:
    cloud = load(npz(points=POINTS.astype(dtype), normals=POINTS.astype(dtype)))
    np.testing.assert_array_equal(cloud.points, POINTS)
    assert str(cloud.points.dtype) == str(cloud.normals.dtype) == result
    assert len(cloud.warnings) == 2


def test_two_candidates_for_the_points(load: Any) -> None:
    cloud = load(npz(pos=POINTS + 1, points=POINTS))
    np.testing.assert_array_equal(cloud.points, POINTS)
    np.testing.assert_array_equal(cloud.attributes["pos"], POINTS + 1)
    assert "pos" in cloud.warnings[0]


def test_metadata_is_text_and_replaced(tmp_path: Path) -> None:
    path = tmp_path / "cloud.npz"
    cloud = PointCloud(points=POINTS, flavour=NpzFlavour())
    write(path, cloud.replaced(POINTS, None, metadata={"device": "cuda:0", "seed": "1"}))
    with np.load(path, allow_pickle=False) as arrays:
        assert arrays["pcdnf_device"].item() == "cuda:0"
    again = read(path)
    assert again.metadata == {"device": "cuda:0", "seed": "1"}
    write(path, again.replaced(POINTS, POINTS, metadata={"device": "cpu"}))
    with np.load(path, allow_pickle=False) as arrays:
        assert list(arrays) == ["points", "normals", "pcdnf_device"]


def test_metadata_does_not_count_as_members(tmp_path: Path) -> None:
    path = tmp_path / "cloud.npz"
    np.savez(path, points=POINTS, **{f"a{index}": np.zeros(4) for index in range(15)})
    cloud = read(path)
    write(path, cloud.replaced(POINTS, None, metadata={f"key{index}": "v" for index in range(12)}))
    assert len(read(path).attributes) == 15


def test_from_ply_and_back(tmp_path: Path) -> None:
    attributes = {
        "red": np.arange(4, dtype=np.uint8),
        "points": np.arange(4, dtype=np.int32),
        "normals": np.zeros(4, "f4"),
    }
    cloud = PointCloud(points=POINTS, normals=-POINTS, attributes=attributes, comments=["one", "two"], obj_info=["o"])
    write(tmp_path / "a.npz", cloud, format="npz")
    middle = read(tmp_path / "a.npz")
    assert middle.comments == ["one", "two"]
    assert list(middle.attributes) == ["red", "points_2", "normals_2"]
    write(tmp_path / "a.ply", middle, format="ply")
    last = read(tmp_path / "a.ply")
    np.testing.assert_array_equal(last.points, POINTS)
    np.testing.assert_array_equal(last.normals, -POINTS)
    np.testing.assert_array_equal(last.attributes["red"], attributes["red"])
    assert (last.comments, last.obj_info) == (["one", "two"], ["o"])


def test_to_ply_colours_wide_integers_and_what_cannot_go(tmp_path: Path, load: Any) -> None:
    big = np.array([0, 1, 2, 2**40])
    cloud = load(
        npz(
            points=POINTS,
            rgb=np.arange(12, dtype="u1").reshape(4, 3),
            label=np.arange(4),
            stamp=big,
            pose=np.eye(3),
            x=big / 2,
            feat=np.ones((4, 2, 2), "f2"),
        )
    )
    notes = write(tmp_path / "a.ply", cloud, format="ply")
    assert notes == ["PLY holds per-point values only; 'pose' was left out."]
    again = read(tmp_path / "a.ply")
    kinds = {name: str(column.dtype) for name, column in again.attributes.items()}
    assert kinds == {
        **dict.fromkeys(("red", "green", "blue"), "uint8"),
        **{"label": "int32", "stamp": "float64", "x_2": "float64"},
        **{f"feat_{index}": "float32" for index in range(4)},
    }
    cloud.attributes["stamp"] = big + 2**60
    with pytest.raises(FormatError) as caught:
        write(tmp_path / "a.ply", cloud, format="ply")
    assert caught.value.code == "cannot_store"


def test_same_cloud_same_bytes(tmp_path: Path) -> None:
    cloud = PointCloud(points=POINTS, flavour=NpzFlavour())
    write(tmp_path / "a", cloud)
    write(tmp_path / "b", cloud)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


NUMBERS = (
    hnp.integer_dtypes(endianness="?")
    | hnp.unsigned_integer_dtypes(endianness="?")
    | hnp.floating_dtypes(endianness="?", sizes=(16, 32, 64))
)


def test_masks_come_back_as_truth_values_and_go_into_other_formats_as_0_and_1(tmp_path: Path) -> None:
    mask = np.arange(len(POINTS)) % 2 == 0
    np.savez(tmp_path / "a.npz", points=POINTS, mask=mask)
    cloud = read(tmp_path / "a.npz")
    write(tmp_path / "b.npz", cloud, check=True)
    with np.load(tmp_path / "b.npz") as again:
        assert again["mask"].dtype == bool
        np.testing.assert_array_equal(again["mask"], mask)
    for ending in ("ply", "pcd", "las", "csv"):
        write(tmp_path / "c", cloud, format=ending, check=True)
        column = read(tmp_path / "c", text=ending == "csv").attributes["mask"]
        assert column.astype(int).tolist() == mask.astype(int).tolist()


def test_bytes_that_are_neither_true_nor_false_are_true(tmp_path: Path) -> None:
    mask = np.arange(len(POINTS), dtype=np.uint8)
    np.savez(tmp_path / "a.npz", points=POINTS, mask=mask.view(bool))
    assert read(tmp_path / "a.npz").attributes["mask"].view(np.uint8).tolist() == (mask > 0).astype(int).tolist()


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data(), compressed=st.booleans())
def test_round_trip_of_any_arrays(tmp_path: Path, data: st.DataObject, compressed: bool) -> None:
    shapes = hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4)
    arrays = {f"a{index}": data.draw(hnp.arrays(data.draw(NUMBERS), data.draw(shapes))) for index in range(3)}
    path = tmp_path / "cloud.npz"
    (np.savez_compressed if compressed else np.savez)(path, points=POINTS, **arrays)
    write(path, read(path))
    with np.load(path, allow_pickle=False) as again:
        assert list(again) == ["points", *arrays]
        for name, array in arrays.items():
            assert again[name].dtype == array.dtype
            np.testing.assert_array_equal(again[name], array)
