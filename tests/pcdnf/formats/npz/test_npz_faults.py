"""NPZ files that break a rule."""

from __future__ import annotations

import io
import struct
import tracemalloc
import zipfile
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pcdnf.formats import FormatError
from tests.support.npz_files import POINTS, Refused, archive, npy, npz, patched, with_header

# What is refused


class Trap:
    """Would leave a trace if it were unpickled."""

    def __reduce__(self) -> tuple[Any, ...]:
        return (pytest.fail, ("unpickled",))


@pytest.mark.parametrize(
    "array",
    [
        np.array([Trap()], dtype=object),
        np.array(["a", "b", "c", "d"]),
        np.array([b"a"]),
        np.ones(4, complex),
        np.zeros(4, "datetime64[s]"),
        np.zeros(4, "timedelta64[s]"),
        np.zeros(4, [("a", "f4"), ("b", "O")]),
        np.zeros(4, "V3"),
    ],
)
def test_types_that_are_not_real_numbers(refused: Refused, array: Any) -> None:
    error = refused(npz(points=POINTS, other=array))
    assert error.code == "unsupported_dtype"
    assert "'other'" in str(error)
    assert refused(npz(points=array)).code == "unsupported_dtype"


def test_truth_values_are_no_coordinates_and_no_normals(refused: Refused) -> None:
    for arrays in ({"points": POINTS > 0}, {"points": POINTS, "normals": POINTS > 0}):
        assert refused(npz(**arrays)).code == "unsupported_dtype"


def test_text_is_read_only_as_a_scalar_of_our_own(refused: Refused) -> None:
    assert refused(npz(points=POINTS, pcdnf_device=np.array(["cpu"]))).code == "unsupported_dtype"
    error = refused(npz(points=POINTS, pcdnf_device=np.array("c" * 200_000)))
    assert (error.code, error.limit) == ("member_too_large", 512 * 1024)


@pytest.mark.parametrize(
    ("shape", "hint"),
    [
        ((3, 40), "transpose"),
        ((40,), "reshape"),
        ((40, 2), "three"),
        ((40, 6), "normals=a"),
        ((40, 9), "members"),
        ((), "row"),
        ((4, 3, 1), "row"),
    ],
)
def test_shapes_of_points(refused: Refused, shape: tuple[int, ...], hint: str) -> None:
    error = refused(npz(points=np.zeros(shape, "f4")))
    assert error.code == "bad_shape"
    assert str(shape) in str(error)
    assert hint in str(error.hint)


def test_normals_of_another_shape(refused: Refused) -> None:
    error = refused(npz(points=POINTS, normals=POINTS[:2]))
    assert error.code == "bad_shape"
    assert "(2, 3)" in str(error)


def test_no_points(refused: Refused) -> None:
    error = refused(npz(vertices=POINTS))
    assert error.code == "missing_coordinates"
    assert "'vertices'" in str(error)


def test_too_many_points_takes_no_memory(refused: Refused) -> None:
    data = npz(points=np.zeros((1_000_000, 3), "f4"))
    tracemalloc.start()
    error = refused(data, max_points=999_999)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert (error.code, error.limit, error.actual) == ("too_many_points", 999_999, 1_000_000)
    assert peak < 4_000_000


def test_a_zip_bomb_takes_no_memory(refused: Refused) -> None:
    file = io.BytesIO()
    np.savez_compressed(file, points=np.zeros((16_000_000, 3), "f4"))
    tracemalloc.start()
    error = refused(file.getvalue())
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert error.code == "compression_ratio"
    assert peak < 1_000_000
    assert refused(file.getvalue(), max_bytes=10**8).code == "file_too_large"


def test_an_archive_that_inflates_to_more_than_it_declares(refused: Refused) -> None:
    honest = archive(("points.npy", npy(POINTS)), method=zipfile.ZIP_DEFLATED)
    size = len(npy(POINTS))
    assert refused(patched(honest, size=size - 12)).code == "corrupt_archive"
    more = archive(("points.npy", npy(POINTS) + bytes(12)), method=zipfile.ZIP_DEFLATED)
    assert refused(more).code == "trailing_data"
    error = refused(patched(more, size=size))
    assert error.code == "corrupt_archive"
    assert "more" in str(error)


def test_an_archive_that_inflates_to_less(refused: Refused) -> None:
    short = archive(("points.npy", npy(POINTS)[:-12]), method=zipfile.ZIP_DEFLATED)
    assert refused(short).code == "truncated"
    assert refused(patched(short, size=len(npy(POINTS)))).code == "corrupt_archive"


@pytest.mark.parametrize(
    "shape",
    [b"(4611686018427387904, 3)", b"(9223372036854775807, 3)", b"(4294967296, 4294967296)", b"(5, 3)", b"(3, 3)"],
)
def test_shapes_that_do_not_match_their_bytes(refused: Refused, shape: bytes) -> None:
    literal = b"{'descr': '<f4', 'fortran_order': False, 'shape': " + shape + b", }\n"
    assert refused(with_header(literal, POINTS.tobytes())).code in ("truncated", "trailing_data")


@pytest.mark.parametrize("version", [1, 2, 3])
def test_versions_of_the_array_header(load: Any, version: int) -> None:
    literal = b"{'shape': (4, 3), \"descr\": '<f4', 'fortran_order': False}   \n"
    np.testing.assert_array_equal(load(with_header(literal, POINTS.tobytes(), version)).points, POINTS)


@pytest.mark.parametrize(
    "literal",
    [
        b"",
        b"{}",
        b"[1]",
        b"{'descr': '<f4', 'fortran_order': False, 'shape': (4, 3), 'more': 1}",
        b"{'descr': '<f4', 'descr': '<f4', 'shape': (4, 3)}",
        b"{'descr': '<f4', 'fortran_order': False, 'shape': (-4, 3)}",
        b"{'descr': '<f4', 'fortran_order': False, 'shape': (4 3)}",
        b"{'descr': '<f4', 'fortran_order': False, 'shape': (12)}",
        b"{'descr': '<f4', 'fortran_order': 1, 'shape': (4, 3)}",
        b"{'descr': '<f4', 'fortran_order': False, 'shape': " + b"(" * 3000 + b"}",
        b"{'descr': __import__('os').abort(), 'fortran_order': False, 'shape': (4, 3)}",
        b"{'descr': '<f4', 'fortran_order': False, 'shape': (" + b"1, " * 9 + b")}",
    ],
)
def test_array_headers_that_break_a_rule(refused: Refused, literal: bytes) -> None:
    assert refused(with_header(literal, POINTS.tobytes())).code == "bad_header"


def test_a_member_that_is_no_array(refused: Refused) -> None:
    for data in (
        b"",
        b"\x93NUM",
        b"text of some length",
        b"\x93NUMPY\x09\x00" + bytes(60),
        b"\x93NUMPY\x01\x00\xff\x00",
    ):
        assert refused(archive(("points.npy", data))).code == "bad_header"


def test_a_header_bomb(refused: Refused) -> None:
    literal = b"{'descr': '<f4', 'fortran_order': False, 'shape': (4, 3), }" + b" " * 600_000
    error = refused(with_header(literal, POINTS.tobytes(), version=2))
    assert (error.code, error.limit) == ("header_too_long", 4096)


def test_too_many_members(refused: Refused) -> None:
    error = refused(npz(points=POINTS, **{f"a{index}": POINTS for index in range(64)}))
    assert (error.code, error.limit, error.actual) == ("too_many_members", 64, 65)
    assert refused(npz(points=POINTS, **{f"pcdnf_{index}": POINTS for index in range(33)})).code == "too_many_members"
    assert refused(npz(points=POINTS, **{f"a{index}": POINTS for index in range(3000)})).code == "too_many_members"


@pytest.mark.parametrize(
    "name",
    [
        "../points.npy",
        "/points.npy",
        "a/points.npy",
        "a\\points.npy",
        "points",
        ".npy",
        "...npy",
        "inner.zip",
        "a\nb.npy",
        "C:x.npy",
        "n" * 200 + ".npy",
    ],
)
def test_names_that_are_not_those_of_arrays(refused: Refused, name: str) -> None:
    error = refused(archive(("points.npy", npy(POINTS)), (name, npy(POINTS))))
    assert error.code == "bad_member_name"
    assert len(str(error)) < 200


def test_a_nested_archive(refused: Refused) -> None:
    inner = npz(points=POINTS)
    assert refused(archive(("scan.zip", archive(("points.npz", inner))))).code == "bad_member_name"
    assert refused(archive(("points.npy", inner))).code == "bad_header"


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_two_members_of_one_name(refused: Refused) -> None:
    assert refused(archive(("points.npy", npy(POINTS)), ("points.npy", npy(POINTS)))).code == "duplicate_member"


def test_encrypted_and_packed_otherwise(refused: Refused) -> None:
    honest = npz(points=POINTS)
    assert refused(patched(honest, flags=1)).code == "encrypted_archive"
    assert refused(archive(("points.npy", npy(POINTS)), method=zipfile.ZIP_LZMA)).code == "unsupported_compression"


def test_zip64_is_refused_whatever_it_says(refused: Refused) -> None:
    honest = npz(points=POINTS)
    assert refused(patched(honest, size=0xFFFFFFFF)).code == "unsupported_zip64"
    assert refused(patched(honest, offset=0xFFFFFFFF)).code == "unsupported_zip64"
    end = honest.index(b"PK\x05\x06")
    assert refused(honest[: end + 16] + b"\xff" * 4 + honest[end + 20 :]).code == "unsupported_zip64"
    located = honest[:end] + b"PK\x06\x07" + bytes(16) + honest[end:]
    assert refused(located).code == "unsupported_zip64"
    entry = honest.index(b"PK\x01\x02")
    longer = bytearray(honest[:end] + struct.pack("<HHQ", 1, 8, 2**40) + honest[end:])
    struct.pack_into("<H", longer, entry + 30, 12)
    struct.pack_into("<I", longer, end + 12 + 12, end + 12 - entry)
    assert refused(bytes(longer)).code == "unsupported_zip64"


def test_sizes_and_offsets_that_lie(refused: Refused) -> None:
    honest = archive(("points.npy", npy(POINTS)), ("other.npy", npy(POINTS)), method=zipfile.ZIP_DEFLATED)
    stored = npz(points=POINTS)
    for fields in (
        {"offset": 5},
        {"offset": 10_000_000},
        {"packed": 10_000_000},
        {"packed": 4000},
        {"crc": 1},
        {"packed": 20},
    ):
        assert refused(patched(honest, **fields)).code == "corrupt_archive"
    assert refused(patched(stored, size=5)).code == "corrupt_archive"
    end = honest.index(b"PK\x05\x06")
    for place in (8, 10, 12, 16):
        changed = bytearray(honest)
        changed[end + place] ^= 1
        assert refused(bytes(changed)).code == "corrupt_archive"


def test_members_that_overlap(refused: Refused) -> None:
    data = bytearray(npz(points=POINTS, b=POINTS))
    second = data.index(b"PK\x01\x02", data.index(b"PK\x01\x02") + 4)
    struct.pack_into("<I", data, second + 42, 0)
    assert refused(bytes(data)).code == "corrupt_archive"


def test_cut_archives_and_trailing_bytes(refused: Refused) -> None:
    honest = npz(points=POINTS)
    for stop in (4, 100, len(honest) - 30, len(honest) - 1):
        assert refused(honest[:stop]).code == "truncated"
    error = refused(honest + b"junk")
    assert (error.code, error.limit, error.actual) == ("trailing_data", len(honest), len(honest) + 4)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_changed_byte_is_read_or_refused(load: Any, data: st.DataObject) -> None:
    honest = bytearray(archive(("points.npy", npy(POINTS)), ("a.npy", npy(POINTS[:, 0])), method=zipfile.ZIP_DEFLATED))
    for _ in range(data.draw(st.integers(1, 3))):
        honest[data.draw(st.integers(4, len(honest) - 1))] = data.draw(st.integers(0, 255))
    try:
        cloud = load(bytes(honest))
    except FormatError:
        return
    assert np.isfinite(cloud.points).all()
