"""PLY files that break a rule."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from pcdnf.formats import PlyFlavour, PointCloud, read, write
from pcdnf.formats.ply.elements import BYTE_ORDERS
from tests.support.ply_files import XYZ, Refused, floats, header, vertices

# What is refused


@pytest.mark.parametrize("count", ["-1", "9223372036854775808", "1e3", "many", "3.0", "0x3", "²"])
def test_a_count_that_is_no_count(refused: Refused, count: str) -> None:
    assert refused(header(*vertices(count)) + floats(3)).code == "bad_header"


def test_a_count_over_the_limit(refused: Refused) -> None:
    error = refused(header(*vertices(101)) + floats(101), max_points=100)
    assert (error.code, error.limit, error.actual) == ("too_many_points", 100, 101)


def test_a_huge_count_takes_no_memory(refused: Refused) -> None:
    tracemalloc.start()
    for encoding in BYTE_ORDERS:
        error = refused(header(*vertices(200_000_000), encoding=encoding), max_points=2**40)
        assert error.code == "truncated"
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1_000_000


def test_counts_whose_product_overflows(refused: Refused) -> None:
    lines = [*vertices(2), "element face 9223372036854775807", "property double a", "property double b"]
    error = refused(header(*lines) + floats(2), max_points=2**63)
    assert error.code == "truncated"
    assert refused(header(*vertices(2**63 - 1)), max_points=2**63).code == "truncated"


def test_a_cut_body_names_both_sizes(refused: Refused) -> None:
    data = header(*vertices(4)) + floats(4)
    error = refused(data[:-1])
    assert (error.code, error.limit, error.actual) == ("truncated", len(data), len(data) - 1)
    assert str(len(data)) in str(error)
    assert str(len(data) - 1) in str(error)


def test_bytes_after_the_last_element(refused: Refused) -> None:
    data = header(*vertices(4)) + floats(4)
    error = refused(data + b"junk")
    assert (error.code, error.limit, error.actual) == ("trailing_data", len(data), len(data) + 4)


def test_cut_and_trailing_text(refused: Refused) -> None:
    head = header(*vertices(3), encoding="ascii")
    error = refused(head + b"1 2 3\n4 5 6           \n       \n")
    assert (error.code, error.limit, error.actual) == ("truncated", 3, 2)


@pytest.mark.parametrize(
    ("faces", "code"),
    [
        (b"\x03" + bytes(12) + b"\x03" + bytes(11), "truncated"),
        (b"\x03" + bytes(12) + b"\x03" + bytes(13), "trailing_data"),
        (b"\x00", "truncated"),
        (b"\x00\xff", "truncated"),
    ],
)
def test_faces_are_checked_to_the_last_byte(refused: Refused, faces: bytes, code: str) -> None:
    lines = [*vertices(2), "element face 2", "property list uchar int vertex_indices"]
    assert refused(header(*lines) + floats(2) + faces).code == code


def test_a_list_of_negative_length(refused: Refused) -> None:
    lines = [*vertices(2), "element face 1", "property list char int vertex_indices"]
    assert refused(header(*lines) + floats(2) + b"\xff").code == "bad_value"


def test_a_long_header_line(refused: Refused) -> None:
    error = refused(header("comment " + "c" * 1100, *vertices(2)) + floats(2))
    assert (error.code, error.limit) == ("header_too_long", 1000)
    assert "Line 3" in str(error)
    exact = "c" * (1000 - len("comment "))
    assert refused(header(f"comment {exact}", *vertices(2))).code == "truncated"


def test_a_long_header(refused: Refused) -> None:
    error = refused(header(*["comment " + "c" * 900] * 80, *vertices(2)) + floats(2))
    assert (error.code, error.limit) == ("header_too_long", 64 * 1024)
    assert refused(b"ply\n" + b"c" * 50_000_000).code == "header_too_long"


def test_many_properties(refused: Refused) -> None:
    error = refused(header(*vertices(2, *XYZ, *(f"uchar a{index}" for index in range(254)))))
    assert (error.code, error.limit, error.actual) == ("too_many_elements", 256, 257)
    error = refused(header(*vertices(2), *(f"element e{index} 0" for index in range(256))))
    assert (error.code, error.limit, error.actual) == ("too_many_elements", 256, 257)


def test_as_many_properties_as_may_be(tmp_path: Path) -> None:
    declared = [*vertices(2, *XYZ, *(f"float a{index}" for index in range(61))), "element face 0", "property uchar b"]
    (tmp_path / "a.ply").write_bytes(header(*declared) + np.arange(2 * 64, dtype="<f4").tobytes())
    cloud = read(tmp_path / "a.ply")
    assert [*cloud.attributes] == [f"a{index}" for index in range(61)]
    assert cloud.attributes["a60"].tolist() == [63, 127]


def test_a_header_without_an_end(refused: Refused) -> None:
    assert refused(b"ply\nformat ascii 1.0\nelement vertex 2\n").code == "bad_header"


@pytest.mark.parametrize(
    "lines",
    [
        ["elephant 3"],
        [""],
        ["element vertex"],
        ["element vertex 2", "element vertex 2"],
        ["property float x"],
        ["element vertex 2", "property float"],
        ["element vertex 2", "property list float x"],
        ["format ascii 1.0"],
        ["element vertex 2", "property float x", "format ascii 1.0"],
        [f"element {'v' * 65} 2"],
        ["element vértex 2"],
    ],
)
def test_header_lines_that_break_a_rule(refused: Refused, lines: list[str]) -> None:
    error = refused(header(*lines))
    assert error.code == "bad_header"
    assert str(error).startswith(f"Line {2 + len(lines)} ")


def test_formats_that_do_not_exist(refused: Refused) -> None:
    assert refused(header(*vertices(2), encoding="binary_middle_endian")).code == "bad_header"
    assert refused(b"ply\nformat ascii 2.0\nend_header\n").code == "bad_header"
    assert refused(b"ply\nend_header\n").code == "bad_header"


def test_lists_of_the_vertices_that_lie(refused: Refused) -> None:
    lines = vertices(2, *XYZ, "list uchar float weights")
    assert refused(header(*lines) + bytes(12) + b"\xff" + bytes(40)).code == "truncated"
    head = header(*lines, encoding="ascii")
    for row in (b"1 2 3", b"1 2 3 2 9", b"1 2 3 -1", b"1 2 3 x", b"1 2 3 0 7", b"1 2 3 9999999999999 1"):
        assert refused(head + row + b"\n4 5 6 1 8 \n").code in ("bad_value", "truncated"), row


def test_missing_and_doubled_coordinates(refused: Refused) -> None:
    error = refused(header(*vertices(2, "float x", "float y")))
    assert error.code == "missing_coordinates"
    assert "'x', 'y'" in str(error)
    assert refused(header("element face 0")).code == "missing_coordinates"
    assert refused(header(*vertices(2, *XYZ, "float x"))).code == "duplicate_property"


@pytest.mark.parametrize("name", ["int64", "half", "float128", "string", "list"])
def test_types_that_ply_does_not_define(refused: Refused, name: str) -> None:
    assert refused(header(*vertices(2, f"{name} x"))).code in ("unsupported_type", "bad_header")
    assert refused(header(*vertices(2), "element face 1", f"property list {name} int at")).code in (
        "unsupported_type",
        "bad_header",
    )


@pytest.mark.parametrize("token", ["abc", "1,5", "1.2.3", "0x10", "1_0", "nan(1)", "1\xa02", "1\x002", "²", "--1"])
def test_text_that_is_no_number(refused: Refused, token: str) -> None:
    data = header(*vertices(2), encoding="ascii") + f"1 2 3\n4 {token} 6\n".encode("latin-1")
    error = refused(data)
    assert error.code == "bad_value"
    assert str(error).isascii()


def test_text_numbers_that_are_not_finite(refused: Refused) -> None:
    for token in ("nan", "inf", "-Infinity", "1e400", "1e39"):
        data = header(*vertices(3), encoding="ascii") + f"1 2 3\n4 5 6\n7 8 {token}\n".encode()
        error = refused(data, nonfinite="reject")
        assert (error.code, error.actual) == ("nonfinite", 1)
        assert "row 2 " in str(error)


def test_a_number_of_many_digits(refused: Refused) -> None:
    data = header(*vertices(2), encoding="ascii") + b"1 2 3\n4 5 " + b"9" * 65 + b"\n"
    error = refused(data)
    assert (error.code, error.limit) == ("bad_value", 64)


@pytest.mark.parametrize("row", ["1 2", "1 2 3 4", "1"])
def test_text_rows_of_another_length(refused: Refused, row: str) -> None:
    error = refused(header(*vertices(3), encoding="ascii") + f"1 2 3\n{row}\n4 5 6\n7 8 9\n".encode())
    assert (error.code, error.limit, error.actual) == ("bad_value", 3, len(row.split()))
    assert "Row 1 " in str(error)


@pytest.mark.parametrize("value", ["256", "-1", "1.5", "nan", "1e30"])
def test_text_integers_that_do_not_fit(refused: Refused, value: str) -> None:
    head = header(*vertices(2, *XYZ, "uchar red"), encoding="ascii")
    error = refused(head + f"1 2 3 4\n5 6 7 {value}\n".encode())
    assert error.code == "bad_value"
    assert "'red'" in str(error)
    assert "Row 1 " in str(error)


def test_text_across_blocks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pcdnf.formats.ply.text._BLOCK_BYTES", 37)
    points = np.random.default_rng(0).normal(size=(200, 3))
    path = tmp_path / "cloud.ply"
    write(path, PointCloud(points=points, flavour=PlyFlavour("ascii")))
    np.testing.assert_array_equal(read(path).points, points)
