"""Kinds of LAS and LAZ of other programs, made of valid files: chunks of any size, no chunks, newer versions."""

from __future__ import annotations

import struct
from pathlib import Path

import laspy
import lazrs
import numpy as np
import pytest

from pcdnf.formats import FormatError, read, write

COUNT = 300
LASZIP = b"laszip encoded"
RECORD_HEAD = 54
CHUNK_AT, ITEMS_AT, ITEM_BYTES = 12, 34, 6


def survey(path: Path, point_format: int, version: str) -> bytes:
    """A file of laspy's with coordinates, intensities and times that differ."""
    rng = np.random.default_rng(point_format)
    las = laspy.LasData(laspy.LasHeader(point_format=point_format, version=version))
    las.header.scales = [0.001] * 3
    las.x, las.y, las.z = rng.uniform(0, 50, (3, COUNT))
    las.intensity = rng.integers(0, 65536, COUNT)
    if "gps_time" in las.point_format.dimension_names:
        las.gps_time = 3e8 + np.sort(rng.uniform(0, 9, COUNT))
    las.write(str(path))
    return path.read_bytes()


def start_of(data: bytes) -> int:
    """Where the points begin."""
    return int(struct.unpack_from("<I", data, 96)[0])


def record_at(data: bytes) -> int:
    """Where the record on compression holds its values."""
    return data.index(LASZIP) - 2 + RECORD_HEAD


def assert_same(path: Path, plain: Path) -> None:
    """The file holds what the uncompressed one does, and a result of it is a LAZ that laspy reads."""
    cloud, expected = read(path), laspy.read(plain)
    np.testing.assert_allclose(cloud.points, np.stack([expected.x, expected.y, expected.z], 1), rtol=0, atol=1e-9)
    np.testing.assert_array_equal(cloud.attributes["intensity"], np.array(expected.intensity))
    write(path.with_name("result.laz"), cloud, check=True)
    again = laspy.read(path.with_name("result.laz"))
    np.testing.assert_array_equal(np.array(again.X), np.array(expected.X))
    np.testing.assert_array_equal(np.array(again.intensity), np.array(expected.intensity))


@pytest.mark.parametrize("mark", [0, 2**32 - 1])
@pytest.mark.parametrize(("point_format", "version"), [(1, "1.2"), (3, "1.3"), (6, "1.4"), (7, "1.4")])
def test_chunks_of_different_sizes_are_read_under_both_marks(
    tmp_path: Path, point_format: int, version: str, mark: int
) -> None:
    plain = survey(tmp_path / "plain.las", point_format, version)
    whole = survey(tmp_path / "whole.laz", point_format, version)
    rows = plain[start_of(plain) :]
    stride = len(rows) // COUNT
    vlr = lazrs.LazVlr.new_for_compression(point_format, 0, True)
    with (tmp_path / "chunks.laz").open("w+b") as file:
        file.write(whole[: start_of(whole)])
        compressor = lazrs.LasZipCompressor(file, vlr)
        for first, last in ((0, 7), (7, 150), (150, COUNT)):
            compressor.compress_many(rows[first * stride : last * stride])
            compressor.finish_current_chunk()
        compressor.done()
    data = bytearray((tmp_path / "chunks.laz").read_bytes())
    struct.pack_into("<I", data, record_at(data) + CHUNK_AT, mark)
    (tmp_path / "chunks.laz").write_bytes(data)
    assert_same(tmp_path / "chunks.laz", tmp_path / "plain.las")


@pytest.mark.parametrize(("point_format", "version"), [(0, "1.2"), (1, "1.2"), (3, "1.2")])
def test_points_of_the_first_laszip_that_are_not_in_chunks(tmp_path: Path, point_format: int, version: str) -> None:
    survey(tmp_path / "plain.las", point_format, version)
    chunked = survey(tmp_path / "chunked.laz", point_format, version)
    start = start_of(chunked)
    (table,) = struct.unpack_from("<q", chunked, start)
    head = bytearray(chunked[:start])
    struct.pack_into("<H", head, record_at(head), 1)
    struct.pack_into("<I", head, record_at(head) + CHUNK_AT, 0)
    (tmp_path / "points.laz").write_bytes(bytes(head) + chunked[start + 8 : table])
    assert_same(tmp_path / "points.laz", tmp_path / "plain.las")


@pytest.mark.parametrize("ending", ["las", "laz"])
def test_a_header_of_las_1_5_is_read_and_kept(tmp_path: Path, ending: str) -> None:
    older = survey(tmp_path / f"older.{ending}", 6, "1.4")
    times = struct.pack("<2dH", 3e8, 3e8 + 9, 0)
    newer = bytearray(older[:375] + times + older[375:])
    newer[25] = 5
    struct.pack_into("<HI", newer, 94, 393, start_of(older) + len(times))
    struct.pack_into("<I5I", newer, 107, *[0] * 6)
    if ending == "laz":
        (table,) = struct.unpack_from("<q", older, start_of(older))
        struct.pack_into("<q", newer, start_of(older) + len(times), table + len(times))
    (tmp_path / f"newer.{ending}").write_bytes(newer)
    cloud = read(tmp_path / f"newer.{ending}")
    np.testing.assert_array_equal(cloud.points, read(tmp_path / f"older.{ending}").points)
    write(tmp_path / f"result.{ending}", cloud, check=True)
    result = (tmp_path / f"result.{ending}").read_bytes()
    assert (result[24], result[25], result[375:393]) == (1, 5, times)


def test_a_newer_compression_is_said_to_be_newer_and_not_damaged(tmp_path: Path) -> None:
    data = bytearray(survey(tmp_path / "a.laz", 6, "1.4"))
    struct.pack_into("<H", data, record_at(data) + ITEMS_AT + ITEM_BYTES - 2, 4)
    (tmp_path / "a.laz").write_bytes(data)
    with pytest.raises(FormatError) as caught:
        read(tmp_path / "a.laz")
    assert caught.value.code == "unsupported_compression"
    assert "newer LASzip" in str(caught.value)
    assert "uncompressed LAS" in str(caught.value.hint)
