"""PLY: what comes back, and one test for each way a file can be wrong."""

from __future__ import annotations

import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from pcdnf.formats import FormatError, PlyFlavour, PointCloud, read, write
from pcdnf.formats.ply_header import BYTE_ORDERS, TYPES

Refused = Callable[..., FormatError]
XYZ = ("float x", "float y", "float z")


def header(*lines: str, encoding: str = "binary_little_endian", newline: str = "\n") -> bytes:
    return "".join(f"{line}{newline}" for line in ("ply", f"format {encoding} 1.0", *lines, "end_header")).encode()


def vertices(count: object, *properties: str) -> list[str]:
    return [f"element vertex {count}", *(f"property {prop}" for prop in properties or XYZ)]


def floats(count: int) -> bytes:
    return np.arange(3 * count, dtype="<f4").tobytes()


# What comes back


@pytest.mark.parametrize("encoding", BYTE_ORDERS)
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_encodings_and_line_ends(tmp_path: Path, encoding: str, newline: str) -> None:
    values = np.array([[0, 1, 2, 255], [3.5, -4, 5e-3, 0]])
    head = header(*vertices(2, *XYZ, "uchar red"), encoding=encoding, newline=newline)
    if encoding == "ascii":
        body = newline.join(" ".join(f"{value:g}" for value in row) for row in values).encode() + newline.encode()
    else:
        body = b"".join(struct.pack(f"{BYTE_ORDERS[encoding]}fffB", *row[:3], int(row[3])) for row in values)
    path = tmp_path / "cloud.bin"
    path.write_bytes(head + body)
    cloud = read(path)
    np.testing.assert_array_equal(cloud.points, values[:, :3].astype("f4"))
    np.testing.assert_array_equal(cloud.attributes["red"], np.array([255, 0], "u1"))
    write(path, cloud)
    again = read(path)
    assert isinstance(again.flavour, PlyFlavour)
    assert again.flavour.encoding == encoding
    np.testing.assert_array_equal(again.points, cloud.points)


def test_everything_a_file_carries_comes_back_byte_for_byte(tmp_path: Path) -> None:
    properties = (
        "uchar red",
        "double y",
        "double x",
        "double z",
        "short tag",
        "float32 nx",
        "float32 ny",
        "float32 nz",
    )
    head = header(
        "comment made by größe", "obj_info num_cols 4", *vertices(2, *properties), encoding="binary_big_endian"
    )
    rows = [struct.pack(">B3dh3f", 7, 4480000.123456789, 2.5, -1.0, -300, 0, 0, 1), struct.pack(">B3dh3f", *range(8))]
    path = tmp_path / "cloud.ply"
    path.write_bytes(head + b"".join(rows))
    cloud = read(path)
    assert cloud.points.dtype == np.float64
    assert cloud.points[0].tolist() == [2.5, 4480000.123456789, -1.0]
    assert cloud.comments == ["made by größe"]
    assert cloud.obj_info == ["num_cols 4"]
    assert [(name, column.dtype) for name, column in cloud.attributes.items()] == [("red", np.uint8), ("tag", np.int16)]
    write(tmp_path / "out.ply", cloud)
    assert (tmp_path / "out.ply").read_bytes() == path.read_bytes()


def test_bytes_of_a_comment_that_are_not_utf8_come_back(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    path.write_bytes(header("comment @", *vertices(2)).replace(b"@", b"\xe9t\xe9") + floats(2))
    write(tmp_path / "out.ply", read(path))
    assert (tmp_path / "out.ply").read_bytes() == path.read_bytes()


def test_new_normals_follow_the_coordinates_in_their_type(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    head = header(*vertices(2, "double x", "double y", "double z", "uchar red"))
    path.write_bytes(head + struct.pack("<3dB3dB", *range(8)))
    cloud = read(path)
    write(path, cloud.replaced(cloud.points, np.eye(3)[:2]))
    again = read(path)
    assert isinstance(again.flavour, PlyFlavour)
    assert [name for name, _ in again.flavour.properties] == ["x", "y", "z", "nx", "ny", "nz", "red"]
    assert dict(again.flavour.properties)["nx"] == "double"
    np.testing.assert_array_equal(again.normals, np.eye(3)[:2])


@pytest.mark.parametrize("names", [("nx", "ny", "nz"), ("normal_x", "normal_y", "normal_z")])
def test_both_spellings_of_normals(tmp_path: Path, names: tuple[str, ...]) -> None:
    path = tmp_path / "cloud.ply"
    data = np.arange(12, dtype="<f4").tobytes()
    path.write_bytes(header(*vertices(2, *XYZ, *(f"float {name}" for name in names))) + data)
    cloud = read(path)
    assert cloud.normals is not None
    np.testing.assert_array_equal(cloud.normals[1], [9, 10, 11])
    assert not cloud.attributes
    write(path, cloud.replaced(cloud.points, -cloud.normals))
    again = read(path)
    np.testing.assert_array_equal(again.normals, -cloud.normals)
    assert isinstance(again.flavour, PlyFlavour)
    assert again.flavour.properties[3][0] == names[0]


def test_partial_normals_stay_properties_and_do_not_collide(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    path.write_bytes(header(*vertices(2, *XYZ, "float nx")) + np.arange(8, dtype="<f4").tobytes())
    cloud = read(path)
    assert cloud.normals is None
    assert "nx" in cloud.warnings[0]
    write(path, cloud.replaced(cloud.points, np.eye(3)[:2]))
    again = read(path)
    np.testing.assert_array_equal(again.attributes["nx"], [3, 7])
    np.testing.assert_array_equal(again.normals, np.eye(3)[:2])


def test_integer_coordinates_come_back_as_float64_with_a_warning(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    properties = ("int x", "int y", "int z", "char nx", "char ny", "char nz")
    path.write_bytes(
        header(*vertices(2, *properties)) + struct.pack("<3i3b3i3b", 1, 2, 3, 0, 0, 127, 4, 5, 6, 0, 127, 0)
    )
    cloud = read(path)
    assert cloud.points.dtype == np.float64
    assert [warning.split(" are ")[0] for warning in cloud.warnings] == ["The coordinates", "The normals"]
    write(path, cloud.replaced(cloud.points + 0.25, cloud.normals))
    again = read(path)
    np.testing.assert_array_equal(again.points, [[1.25, 2.25, 3.25], [4.25, 5.25, 6.25]])
    assert isinstance(again.flavour, PlyFlavour)
    assert {spelled for _, spelled in again.flavour.properties} == {"double"}


def test_coordinates_of_mixed_types_keep_their_own(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    path.write_bytes(header(*vertices(2, "double x", "float y", "float z")) + struct.pack("<dffdff", *range(6)))
    cloud = read(path)
    write(tmp_path / "out.ply", cloud)
    assert cloud.points.dtype == np.float64
    assert (tmp_path / "out.ply").read_bytes() == path.read_bytes()


def test_faces_after_the_vertices_are_left_out_with_a_warning(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    lines = [*vertices(3), "element face 3", "property list uchar int vertex_indices", "property uchar flag"]
    faces = struct.pack("<B3iB", 3, 0, 1, 2, 9) * 2 + struct.pack("<B4iB", 4, 0, 1, 2, 0, 9)
    path.write_bytes(header(*lines) + floats(3) + faces)
    cloud = read(path)
    assert len(cloud) == 3
    assert "'face' (3 rows)" in cloud.warnings[0]


def test_elements_before_the_vertices_are_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    lines = ["element camera 2", "property double f", "element strip 2", "property list ushort short at", *vertices(2)]
    strips = struct.pack("<H2hH", 2, 5, 6, 0)
    path.write_bytes(header(*lines) + bytes(16) + strips + floats(2))
    np.testing.assert_array_equal(read(path).points.ravel(), np.arange(6))
    text = header(*lines, encoding="ascii") + b"1\n2\n2 5 6\n0\n\n0 1 2\n3 4 5\n"
    path.write_bytes(text)
    np.testing.assert_array_equal(read(path).points.ravel(), np.arange(6))


def test_lists_of_changing_length_are_walked(tmp_path: Path) -> None:
    lengths = np.random.default_rng(0).choice([3, 3, 3, 4, 0], size=500)
    faces = b"".join(struct.pack(f">B{n}I", n, *range(n)) for n in lengths)
    lines = [*vertices(2), "element face 500", "property list uchar uint vertex_indices"]
    path = tmp_path / "cloud.ply"
    path.write_bytes(header(*lines, encoding="binary_big_endian") + np.arange(6, dtype=">f4").tobytes() + faces)
    np.testing.assert_array_equal(read(path).points.ravel(), np.arange(6))


def test_metadata_is_read_apart_from_comments_and_replaced(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    path.write_bytes(
        header("comment kept", "comment pcdnf device: cuda:0", "comment pcdnf seed: 3", *vertices(2)) + floats(2)
    )
    cloud = read(path)
    assert cloud.comments == ["kept"]
    assert cloud.metadata == {"device": "cuda:0", "seed": "3"}
    write(path, cloud.replaced(cloud.points, None, metadata={"device": "cpu"}))
    assert path.read_bytes().count(b"pcdnf") == 1
    assert read(path).metadata == {"device": "cpu"}


def test_a_long_or_broken_comment_is_wrapped_to_what_a_reader_accepts(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    cloud = PointCloud(points=np.eye(3), comments=["ö" * 900, "two\nlines"])
    write(path, cloud)
    again = read(path)
    assert "".join(again.comments[:2]) == "ö" * 900
    assert again.comments[2:] == ["two", "lines"]


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data(), encoding=st.sampled_from(sorted(BYTE_ORDERS)), wide=st.booleans())
def test_round_trip_of_any_values(tmp_path: Path, data: st.DataObject, encoding: str, wide: bool) -> None:
    dtype = np.float64 if wide else np.float32
    count = data.draw(st.integers(2, 5))
    finite = st.floats(-1e6, 1e6, width=64 if wide else 32)
    points = data.draw(hnp.arrays(dtype, (count, 3), elements=finite))
    points[0] = 1e3
    points[1] = -1e3
    kinds = sorted(set(TYPES.values()))
    attributes = {f"a{index}": data.draw(hnp.arrays(data.draw(st.sampled_from(kinds)), (count,))) for index in range(3)}
    normals = data.draw(st.none() | hnp.arrays(np.float32, (count, 3), elements=st.floats(-1, 1, width=32)))
    cloud = PointCloud(points=points, normals=normals, attributes=attributes, flavour=PlyFlavour(encoding))
    path = tmp_path / "cloud.ply"
    write(path, cloud)
    again = read(path)
    assert again.points.dtype == dtype
    np.testing.assert_array_equal(again.points, points)
    if normals is None:
        assert again.normals is None
    else:
        np.testing.assert_array_equal(again.normals, normals)
    for name, column in attributes.items():
        assert again.attributes[name].dtype == column.dtype
        np.testing.assert_array_equal(again.attributes[name], column)


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
    assert refused(head + b"1 2 3\n4 5 6\n7 8 9\nx").code == "trailing_data"


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
    error = refused(header(*vertices(2, *XYZ, *(f"uchar a{index}" for index in range(62)))))
    assert (error.code, error.limit, error.actual) == ("too_many_elements", 64, 65)
    error = refused(header(*vertices(2), *(f"element e{index} 0" for index in range(64))))
    assert (error.code, error.limit, error.actual) == ("too_many_elements", 64, 65)


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


def test_a_list_in_the_vertex(refused: Refused) -> None:
    assert refused(header(*vertices(2, *XYZ, "list uchar float weights"))).code == "list_property"


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
        error = refused(header(*vertices(3), encoding="ascii") + f"1 2 3\n4 5 6\n7 8 {token}\n".encode())
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
    monkeypatch.setattr("pcdnf.formats.ply_text._BLOCK_BYTES", 37)
    points = np.random.default_rng(0).normal(size=(200, 3))
    path = tmp_path / "cloud.ply"
    write(path, PointCloud(points=points, flavour=PlyFlavour("ascii")))
    np.testing.assert_array_equal(read(path).points, points)
