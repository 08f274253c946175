"""LAS and LAZ: against laspy in both directions, what comes back, and one test for each way a file can be wrong."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest

from pcdnf.formats import FormatError, PointCloud, read, write
from pcdnf.formats.las.grid import Grid, grid_for, snapped
from pcdnf.formats.las.points import RECORDS

COUNT = 50
Refused = Callable[..., FormatError]


def survey(path: Path, point_format: int = 7, version: str = "1.4") -> laspy.LasData:
    """A file of laspy's with a value in every dimension, extra dimensions and a coordinate system."""
    rng = np.random.default_rng(point_format)
    las = laspy.LasData(laspy.LasHeader(point_format=point_format, version=version))
    las.header.scales, las.header.offsets = [0.001, 0.001, 0.01], [500_000, 4_480_000, 0]
    las.x, las.y = 500_000 + rng.uniform(0, 1, COUNT), 4_480_000 + rng.uniform(0, 1, COUNT)
    las.z = rng.uniform(0, 9, COUNT)
    for name in las.point_format.standard_dimension_names:
        if name not in ("X", "Y", "Z"):
            info = las.point_format.dimension_by_name(name)
            las[name] = rng.integers(0, 2 ** min(info.num_bits, 15) if info.num_bits < 8 else 100, COUNT)
    las.add_extra_dim(laspy.ExtraBytesParams("height", np.float32, "above ground"))
    las.add_extra_dim(laspy.ExtraBytesParams("tag", np.uint64))
    las["height"], las["tag"] = rng.normal(size=COUNT), np.arange(COUNT, dtype=np.uint64) + 2**60
    las.header.vlrs.append(laspy.VLR("somebody", 77, "their record", b"\0\1\2binary"))
    las.header.vlrs.append(laspy.VLR("LASF_Projection", 2112, "crs", b'COMPD_CS["UTM"]\0'))
    las.write(str(path))
    return las


# What comes back

VERSIONS = [(0, "1.2"), (1, "1.1"), (2, "1.2"), (3, "1.3"), (6, "1.4"), (7, "1.4"), (8, "1.4")]


@pytest.mark.parametrize("ending", ["las", "laz"])
@pytest.mark.parametrize(("point_format", "version"), VERSIONS)
def test_files_of_laspy(tmp_path: Path, point_format: int, version: str, ending: str) -> None:
    path = tmp_path / f"cloud.{ending}"
    las = survey(path, point_format, version)
    cloud = read(path)
    assert cloud.points.dtype == np.float64
    np.testing.assert_allclose(cloud.points, np.stack([las.x, las.y, las.z], 1), rtol=0, atol=1e-9)
    for name in (*las.point_format.standard_dimension_names, "height", "tag"):
        if name not in ("X", "Y", "Z"):
            np.testing.assert_array_equal(cloud.attributes[name], np.array(las[name]), name)
    assert cloud.flavour.format == ending
    # Back again, with normals, as laspy reads it
    moved = cloud.points + np.array([0.01, 0, -0.1])
    normals = np.tile([0.0, 0.6, 0.8], (COUNT, 1))
    result = cloud.replaced(moved, normals.astype(np.float32), metadata={"seed": "0", "device": "cpu"})
    assert write(path, result) == []
    again = laspy.read(path)
    assert again.header.version == las.header.version
    assert again.point_format.id == point_format
    np.testing.assert_array_equal(again.header.scales, las.header.scales)
    np.testing.assert_array_equal(again.header.offsets, las.header.offsets)
    np.testing.assert_allclose(np.stack([again.x, again.y, again.z], 1), moved, atol=0.0051)
    np.testing.assert_allclose(again.header.maxs, [again.x.max(), again.y.max(), again.z.max()])
    np.testing.assert_allclose(again["NormalZ"], 0.8, atol=1e-6)
    for name in (*las.point_format.standard_dimension_names, "height", "tag"):
        if name not in ("X", "Y", "Z"):
            np.testing.assert_array_equal(np.array(again[name]), np.array(las[name]), name)
    kept = {(vlr.user_id, vlr.record_id): vlr.record_data_bytes() for vlr in again.header.vlrs}
    assert kept["somebody", 77] == b"\0\1\2binary"
    assert b"COMPD_CS" in kept["LASF_Projection", 2112]
    assert list(again.header.number_of_points_by_return[:5]) == [
        int((np.array(las.return_number) == number).sum()) for number in range(1, 6)
    ]
    third = read(path)
    assert third.metadata == {"seed": "0", "device": "cpu"}
    np.testing.assert_allclose(third.normals, normals, atol=1e-6)
    np.testing.assert_allclose(third.points, moved, atol=0.0051)
    write(tmp_path / "third", third)
    assert (tmp_path / "third").read_bytes() == path.read_bytes()


def test_an_unchanged_las_is_byte_for_byte_the_same(tmp_path: Path) -> None:
    survey(tmp_path / "a.las", 8)
    write(tmp_path / "b.las", read(tmp_path / "a.las"))
    first, second = (tmp_path / "a.las").read_bytes(), (tmp_path / "b.las").read_bytes()
    start, other = (struct.unpack_from("<I", data, 96)[0] for data in (first, second))
    assert first[start:] == second[other:]
    assert len(first) == len(second)


def test_extended_records_are_kept(tmp_path: Path) -> None:
    for ending in ("las", "laz"):
        las = survey(tmp_path / "a", 6)
        las.evlrs = laspy.vlrs.vlrlist.VLRList([laspy.VLR("late", 5, "after", b"x" * 70_000)])
        path = tmp_path / f"a.{ending}"
        las.write(str(path))
        cloud = read(path)
        write(path, cloud.replaced(cloud.points, np.ones((COUNT, 3))))
        assert laspy.read(path).evlrs[0].record_data_bytes() == b"x" * 70_000


def test_las_to_laz_and_to_others(tmp_path: Path) -> None:
    survey(tmp_path / "a.las", 7)
    cloud = read(tmp_path / "a.las")
    with pytest.raises(FormatError) as caught:
        write(tmp_path / "out", cloud, format="ply")
    assert caught.value.code == "cannot_store", "of 2^60"
    del cloud.attributes["tag"]
    for format_ in ("laz", "las", "ply", "npz", "pcd", "xyz", "csv"):
        notes = write(tmp_path / "out", cloud, format=format_)
        assert ["float32" in note for note in notes] == [True] * (format_ == "pcd")
        again = read(tmp_path / "out", text=True)
        np.testing.assert_allclose(again.points, cloud.points, rtol=0, atol=1e-8 if format_ == "pcd" else 0)
        column = again.attributes["classification"]
        np.testing.assert_array_equal(column.astype(int), cloud.attributes["classification"])
        assert again.flavour.format == format_


@pytest.mark.parametrize("ending", ["las", "laz"])
def test_from_other_formats(tmp_path: Path, ending: str) -> None:
    rng = np.random.default_rng(0)
    cloud = PointCloud(
        points=rng.normal(size=(COUNT, 3)) + np.array([500_000, 4_480_000, 100]),
        normals=rng.normal(size=(COUNT, 3)),
        attributes={
            **{name: np.arange(COUNT, dtype=np.uint8) * 5 for name in ("red", "green", "blue")},
            "intensity": rng.normal(size=COUNT).astype(np.float32),
            "classification": np.full(COUNT, 2, np.int32),
            "pair": rng.integers(-9, 9, (COUNT, 2)),
            "a very long name of a column that LAS cannot hold": np.ones(COUNT, bool),
        },
        comments=["survey 12"],
        metadata={"seed": "0"},
    )
    path = tmp_path / "cloud"
    (note,) = write(path, cloud, format=ending, check=True)
    assert "intensities" in note, "negative ones have no place in LAS"
    las = laspy.read(path)
    assert (las.point_format.id, str(las.header.version)) == (7, "1.4")
    np.testing.assert_array_equal(las.red, np.arange(COUNT) * 5 * 257)
    np.testing.assert_array_equal(las.classification, 2)
    again = read(path)
    np.testing.assert_allclose(again.points, cloud.points, atol=6e-4)
    np.testing.assert_array_equal(again.normals, cloud.normals)
    np.testing.assert_array_equal(again.attributes["intensity_1"], cloud.attributes["intensity"])
    np.testing.assert_array_equal(again.attributes["pair_1"], cloud.attributes["pair"][:, 1])
    assert (again.comments, again.metadata) == (["survey 12"], {"seed": "0"})
    first = path.read_bytes()
    write(path, cloud, format=ending)
    assert path.read_bytes() == first, "no clock in the file"


def test_scaled_dimensions_keep_their_stored_numbers(tmp_path: Path) -> None:
    las = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    las.x, las.y, las.z = np.random.default_rng(0).uniform(0, 1, (3, COUNT))
    las.add_extra_dim(laspy.ExtraBytesParams("depth", np.int32, scales=[0.01], offsets=[5.0]))
    las["depth"] = np.linspace(0, 9, COUNT)
    las.write(str(tmp_path / "a.las"))
    cloud = read(tmp_path / "a.las")
    assert "'depth'" in cloud.warnings[0]
    assert cloud.attributes["depth"].dtype == np.int32
    write(tmp_path / "b.las", cloud)
    np.testing.assert_array_equal(np.array(laspy.read(tmp_path / "b.las")["depth"]), np.array(las["depth"]))


def test_dropped_points_are_counted_anew(tmp_path: Path) -> None:
    survey(tmp_path / "a.las", 1, "1.2")
    cloud = read(tmp_path / "a.las")
    half = PointCloud(points=cloud.points[::2], attributes={k: v[::2] for k, v in cloud.attributes.items()},
                      flavour=cloud.flavour)  # fmt: skip
    write(tmp_path / "b.las", half)
    assert laspy.read(tmp_path / "b.las").header.point_count == COUNT // 2


# The grid


def test_the_grid_of_the_file_is_kept_unless_it_is_too_coarse() -> None:
    points = np.random.default_rng(0).uniform(0, 10, (1000, 3))
    fine = Grid((0.001, 0.01, 0.0123), (5.0, -3.0, 0.5))
    assert grid_for(points, fine) == (fine, [])
    grid, notes = grid_for(points, Grid((1.0, 0.001, 0.001), (0.0, 0.0, 0.0)))
    assert grid.scales == (0.01, 0.001, 0.001)
    assert "too coarse" in notes[0]
    assert "x is stored" in notes[0]
    far = points + np.array([1e9, 0, 0])
    grid, notes = grid_for(far, fine)
    assert notes
    np.testing.assert_allclose(snapped(far, grid) * np.array(grid.scales) + grid.offsets, far, atol=0.01)


@pytest.mark.parametrize("size", [1e-9, 1e-3, 1.0, 1e4, 1e9])
@pytest.mark.parametrize("shift", [0.0, 1e6])
def test_a_new_grid_is_fine_enough_and_holds_the_points(size: float, shift: float) -> None:
    if shift / size > 1e9:
        return
    points = np.random.default_rng(0).uniform(-1, 1, (1000, 3)) * size + shift
    grid, notes = grid_for(points, None)
    stored = snapped(points, grid)
    error = np.abs(stored * np.array(grid.scales) + np.array(grid.offsets) - points)
    assert notes == []
    assert error.max() < 1e-3 * size
    assert np.abs(stored.astype(np.int64)).max() < 2**31 - 1


# What is refused


@pytest.fixture(scope="module")
def las_bytes(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("las") / "a.las"
    survey(path, 7)
    return path.read_bytes()


@pytest.fixture(scope="module")
def laz_bytes(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("laz") / "a.laz"
    survey(path, 7)
    return path.read_bytes()


def changed(data: bytes, at: int, form: str, *values: Any) -> bytes:
    copy = bytearray(data)
    struct.pack_into(form, copy, at, *values)
    return bytes(copy)


@pytest.mark.parametrize(
    ("at", "form", "value", "code"),
    [
        (24, "<B", 2, "bad_header"),
        (25, "<B", 9, "bad_header"),
        (25, "<B", 2, "bad_header"),
        (94, "<H", 100, "bad_header"),
        (94, "<H", 65535, "bad_header"),
        (96, "<I", 10, "bad_header"),
        (96, "<I", 2**32 - 1, "truncated"),
        (100, "<I", 2**32 - 1, "header_too_long"),
        (100, "<I", 900, "bad_header"),
        (104, "<B", 11, "bad_header"),
        (104, "<B", 10, "bad_header"),
        (105, "<H", 10, "bad_header"),
        (105, "<H", 50, "truncated"),
        (247, "<Q", 2**63, "truncated"),
        (247, "<Q", COUNT + 1, "truncated"),
        (247, "<Q", COUNT - 1, "trailing_data"),
        (247, "<Q", 0, "trailing_data"),
        (131, "<d", 0.0, "bad_header"),
        (131, "<d", float("nan"), "bad_header"),
        (155, "<d", float("inf"), "bad_header"),
        (131, "<d", 1e300, "extent_out_of_range"),
        (243, "<I", 5, "bad_header"),
    ],
)
def test_headers_that_lie(refused: Refused, las_bytes: bytes, at: int, form: str, value: Any, code: str) -> None:
    assert refused(changed(las_bytes, at, form, value)).code == code


def test_cut_and_lengthened(refused: Refused, las_bytes: bytes, laz_bytes: bytes) -> None:
    for length in (4, 100, 226, 300, 500, len(las_bytes) - 1):
        assert refused(las_bytes[:length]).code == "truncated"
    assert refused(las_bytes + b"\0").code == "trailing_data"
    for length in (4, 300, len(laz_bytes) - 1, len(laz_bytes) - 200):
        assert refused(laz_bytes[:length]).code in ("truncated", "bad_header", "corrupt_archive")


def test_compressed_points_that_lie(refused: Refused, laz_bytes: bytes) -> None:
    start = struct.unpack_from("<I", laz_bytes, 96)[0]
    assert refused(changed(laz_bytes, start, "<q", 10)).code == "bad_header"
    assert refused(changed(laz_bytes, start, "<q", 2**62)).code == "bad_header"
    assert "before its points" in str(refused(changed(laz_bytes, 243, "<I", 1)))
    table = struct.unpack_from("<q", laz_bytes, start)[0]
    assert refused(changed(laz_bytes, table + 4, "<I", 2**32 - 1)).code == "bad_header"
    assert refused(changed(laz_bytes, 247, "<Q", 10**7)).code in ("compression_ratio", "bad_header")
    assert refused(changed(laz_bytes, 247, "<Q", 10**6), max_bytes=10**6).code == "file_too_large"
    assert refused(changed(laz_bytes, 247, "<Q", COUNT + 100)).code == "corrupt_archive"
    at = laz_bytes.index(b"laszip encoded") - 2 + 54
    for offset, form, value in ((0, "<H", 9), (32, "<H", 9), (36, "<H", 99)):
        assert refused(changed(laz_bytes, at + offset, form, value)).code == "bad_header"


def test_layers_are_not_allocated_on_their_word(refused: Refused, laz_bytes: bytes) -> None:
    start, stride = struct.unpack_from("<I", laz_bytes, 96)[0], struct.unpack_from("<H", laz_bytes, 105)[0]
    layers = start + 8 + stride + 4
    for at in (0, 4, 36, 40):
        assert refused(changed(laz_bytes, layers + at, "<I", 2**32 - 16)).code == "corrupt_archive"


def test_wave_packets(tmp_path: Path) -> None:
    las = laspy.LasData(laspy.LasHeader(point_format=9, version="1.4"))
    las.x, las.y, las.z = np.random.default_rng(0).uniform(0, 1, (3, COUNT))
    las["return_point_wave_location"] = np.arange(COUNT, dtype=np.float32)
    las.write(str(tmp_path / "a.las"))
    cloud = read(tmp_path / "a.las")
    for ending in ("las", "laz"):
        write(tmp_path / f"b.{ending}", cloud, format=ending)
        again = read(tmp_path / f"b.{ending}")
        np.testing.assert_array_equal(again.attributes["wave_packet"], cloud.attributes["wave_packet"])
    np.testing.assert_array_equal(laspy.read(tmp_path / "b.las")["return_point_wave_location"], np.arange(COUNT))


def test_limits_of_points(refused: Refused, las_bytes: bytes) -> None:
    assert refused(las_bytes, max_points=COUNT - 1).code == "too_many_points"
    assert refused(las_bytes, minimum_points=COUNT + 1).code == "too_few_points"


def test_without_its_library_laz_says_what_to_install(
    refused: Refused, las_bytes: bytes, laz_bytes: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pcdnf.file_formats.importlib.util.find_spec", lambda _: None)
    error = refused(laz_bytes)
    assert error.code == "missing_extra"
    assert "pcdnf[las]" in str(error.hint)
    (tmp_path / "a.las").write_bytes(las_bytes)
    cloud = read(tmp_path / "a.las")
    with pytest.raises(FormatError) as caught:
        write(tmp_path / "a.laz", cloud, format="laz")
    assert caught.value.code == "missing_extra"


def test_point_formats_have_the_sizes_of_the_standard() -> None:
    sizes = [20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67]
    assert [np.dtype(list(fields)).itemsize for fields in RECORDS.values()] == sizes


def test_values_beyond_the_range_of_a_dimension_are_kept_with_a_warning(tmp_path: Path) -> None:
    columns = {
        "classification": np.array([2, 300, 3]),
        "number_of_returns": np.array([1, 2, 16]),
        "red": np.array([-1.0, 0, 1]),
        "green": np.zeros(3),
        "blue": np.zeros(3),
        "user_data": np.array([0, 1, 255]),
    }
    notes = write(tmp_path / "a.las", PointCloud(points=np.eye(3), attributes=columns), check=True)
    (note,) = [note for note in notes if "another range" in note]
    assert note.startswith("LAS has another range of 'classification', 'number_of_returns', 'red';")
    found = read(tmp_path / "a.las").attributes
    assert found["classification_1"].tolist() == [2, 300, 3]
    assert found["red_1"].tolist() == [-1, 0, 1]
    assert found["user_data"].tolist() == [0, 1, 255]
