"""Clouds packed by gzip or alone in a zip archive are read; what is packed otherwise, or too large, is refused."""

from __future__ import annotations

import gzip
import io
import zipfile
from pathlib import Path

import numpy as np
import pytest

from pcdnf.formats import FormatError, Limits, PointCloud, read, write
from pcdnf.formats.packed import unpack

POINTS = np.random.default_rng(0).normal(size=(40, 3))
TEXT = "".join(f"{x} {y} {z}\n" for x, y, z in POINTS).encode()


@pytest.fixture
def ply(tmp_path: Path) -> bytes:
    write(tmp_path / "plain.ply", PointCloud(points=POINTS))
    return (tmp_path / "plain.ply").read_bytes()


def zipped(method: int = zipfile.ZIP_DEFLATED, **members: bytes) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as archive:
        for name, content in members.items():
            archive.writestr(name.replace("__", "/").replace("_dot_", "."), content)
    return buffer.getvalue()


def code(path: Path, **limits: int) -> str:
    with pytest.raises(FormatError) as caught:
        read(path, limits=Limits(**limits))
    assert caught.value.hint
    return caught.value.code


def put(folder: Path, name: str, content: bytes) -> Path:
    (folder / name).write_bytes(content)
    return folder / name


@pytest.mark.parametrize("name", ["a.ply.gz", "a.gz", "a.PLY.GZ", "whatever"])
def test_gzip(ply: bytes, tmp_path: Path, name: str) -> None:
    np.testing.assert_array_equal(read(put(tmp_path, name, gzip.compress(ply))).points, POINTS)
    halves = gzip.compress(ply[:100]) + gzip.compress(ply[100:])
    np.testing.assert_array_equal(read(put(tmp_path, name, halves)).points, POINTS)


def test_text_is_known_by_the_name_without_the_packing(tmp_path: Path) -> None:
    np.testing.assert_array_equal(read(put(tmp_path, "a.xyz.gz", gzip.compress(TEXT))).points, POINTS)
    np.testing.assert_array_equal(read(put(tmp_path, "a.zip", zipped(a_dot_xyz=TEXT))).points, POINTS)
    assert code(put(tmp_path, "a.gz", gzip.compress(TEXT))) == "unknown_format"


def test_zip_with_one_cloud(ply: bytes, tmp_path: Path) -> None:
    archive = zipped(scans__a_dot_ply=ply, readme_dot_md=b"notes", scans___dot_a_dot_ply=b"fork")
    np.testing.assert_array_equal(read(put(tmp_path, "a.zip", archive)).points, POINTS)


def test_an_npz_stays_an_npz(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", points=POINTS)
    np.testing.assert_array_equal(read(tmp_path / "a.npz").points, POINTS)


def test_archives_that_are_refused(ply: bytes, tmp_path: Path) -> None:
    assert code(put(tmp_path, "a.zip", zipped(a_dot_ply=ply, b_dot_ply=ply))) == "too_many_members"
    assert code(put(tmp_path, "a.zip", zipped(a_dot_jpg=ply))) == "bad_member_name"
    assert code(put(tmp_path, "a.zip", zipped(zipfile.ZIP_BZIP2, a_dot_ply=ply))) == "unsupported_compression"
    broken = bytearray(zipped(a_dot_ply=ply))
    broken[60] ^= 0xFF
    assert code(put(tmp_path, "a.zip", bytes(broken))) == "corrupt_archive"
    assert code(put(tmp_path, "a.zip", zipped(a_dot_ply=zipped(a_dot_ply=ply)))) in (
        "bad_member_name",
        "unknown_format",
    )


def test_gzip_that_is_refused(ply: bytes, tmp_path: Path) -> None:
    packed = gzip.compress(ply)
    assert code(put(tmp_path, "a.gz", packed[:-10])) == "truncated"
    assert code(put(tmp_path, "a.gz", packed + b"more")) == "trailing_data"
    assert code(put(tmp_path, "a.gz", packed[:30] + b"\xff" * 20 + packed[50:])) == "corrupt_archive"
    assert code(put(tmp_path, "a.gz", gzip.compress(packed))) == "unknown_format"


@pytest.mark.parametrize("pack", [gzip.compress, lambda content: zipped(a_dot_ply=content)])
def test_what_unpacks_to_too_much_stops_early(tmp_path: Path, pack: object) -> None:
    bomb = put(tmp_path, "bomb", pack(bytes(40_000_000)))  # type: ignore[operator]
    assert bomb.stat().st_size < 50_000
    assert code(bomb) == "compression_ratio"
    target = tmp_path / "target"
    with bomb.open("rb") as source, target.open("wb") as out, pytest.raises(FormatError) as caught:
        unpack(source, "bomb", out, 3_000_000)
    assert (caught.value.code, caught.value.limit) == ("file_too_large", 3_000_000)
    assert target.stat().st_size <= 3_000_000
