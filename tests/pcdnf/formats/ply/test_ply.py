"""PLY: what comes back, and one test for each way a file can be wrong."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from pcdnf.formats import PlyFlavour, PointCloud, read, write
from pcdnf.formats.ply.elements import BYTE_ORDERS, TYPES
from tests.support.ply_files import XYZ, floats, header, vertices

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


def test_faces_come_back_unless_vertices_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    lines = [*vertices(3), "element face 3", "property list uchar int vertex_indices", "property uchar flag"]
    faces = struct.pack("<B3iB", 3, 0, 1, 2, 9) * 2 + struct.pack("<B4iB", 4, 0, 1, 2, 0, 9)
    path.write_bytes(header(*lines) + floats(3) + faces)
    cloud = read(path)
    assert (len(cloud), cloud.warnings) == (3, [])
    result = cloud.replaced(cloud.points + 1, np.ones((3, 3)))
    assert write(tmp_path / "out.ply", result, check=True) == []
    data = (tmp_path / "out.ply").read_bytes()
    assert data.endswith(faces)
    assert b"element face 3\nproperty list uchar int vertex_indices\nproperty uchar flag\nend_header" in data
    np.testing.assert_array_equal(read(tmp_path / "out.ply").points, cloud.points + 1)
    (note,) = write(tmp_path / "out.ply", cloud.without(np.array([1]), "Outliers"))
    assert "'face'" in note
    assert faces not in (tmp_path / "out.ply").read_bytes()
    notes = write(tmp_path / "out.pcd", cloud, format="pcd")
    assert "'face'" in notes[0], "never dropped silently"


def test_faces_of_text_come_back(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    lines = [*vertices(3), "element face 2", "property list uchar int vertex_indices"]
    path.write_bytes(header(*lines, encoding="ascii") + b"0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n3 0 2 1")
    write(tmp_path / "out.ply", read(path))
    assert (tmp_path / "out.ply").read_bytes().endswith(b"0 1 0\n3 0 1 2\n3 0 2 1\n")


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_lists_of_the_vertices_are_left_out(tmp_path: Path, encoding: str) -> None:
    lines = vertices(
        3, "float x", "list uchar ushort seen", "float y", "float z", "uchar red", "list uchar float weights"
    )
    order = ">" if "big" in encoding else "<"
    body = b""
    for row in range(3):
        if encoding == "ascii":
            seen = " ".join(["7"] * row)
            body += f"{row} {row} {seen} 5 {row * row} {row + 9} 1 0.5\n".encode()
        else:
            body += struct.pack(f"{order}fB{row}HffBBf", row, row, *[7] * row, 5, row * row, row + 9, 1, 0.5)
    (tmp_path / "a.ply").write_bytes(header(*lines, encoding=encoding) + body)
    cloud = read(tmp_path / "a.ply")
    np.testing.assert_array_equal(cloud.points, [[0, 5, 0], [1, 5, 1], [2, 5, 4]])
    assert cloud.attributes["red"].tolist() == [9, 10, 11]
    assert "'seen', 'weights'" in cloud.warnings[0]
    write(tmp_path / "b.ply", cloud, check=True)
    assert b"list" not in (tmp_path / "b.ply").read_bytes()


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian"])
def test_headers_whose_lines_end_with_a_bare_carriage_return(tmp_path: Path, encoding: str) -> None:
    body = b"1 2 3\r4 5 6\r" if encoding == "ascii" else struct.pack("<6f", *range(1, 7))
    head = header(*vertices(2), encoding=encoding).replace(b"\n", b"\r")
    (tmp_path / "a.ply").write_bytes(head + body)
    np.testing.assert_array_equal(read(tmp_path / "a.ply").points, [[1, 2, 3], [4, 5, 6]])


def test_rows_after_the_last_are_left_out_with_a_warning(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_bytes(header(*vertices(2), encoding="ascii") + b"1 2 3\n4 5 6\n7 8 9\n")
    cloud = read(tmp_path / "a.ply")
    assert (len(cloud), "more rows" in cloud.warnings[0]) == (2, True)


def test_splats_are_warned_of(tmp_path: Path) -> None:
    names = [*(f"f_dc_{i}" for i in range(3)), *(f"f_rest_{i}" for i in range(45)), "opacity",
             *(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4)), "red", "green", "blue"]  # fmt: skip
    columns = [*XYZ, "float nx", "float ny", "float nz", *(f"float {name}" for name in names)]
    data = np.arange(2 * len(columns), dtype="<f4").tobytes()
    (tmp_path / "a.ply").write_bytes(header(*vertices(2, *columns)) + data)
    cloud = read(tmp_path / "a.ply")
    assert "Gaussian splats" in cloud.warnings[0]
    assert cloud.attributes["rot_3"].tolist() == [61, 126]


@pytest.mark.parametrize(
    "declared", [("scalar_confidence",), ("confidence",), ("confidence", "scalar_confidence"), ("scalar_displacement",)]
)
def test_columns_of_confidence_come_back_under_the_name_they_had(tmp_path: Path, declared: tuple[str, ...]) -> None:
    data = np.arange(2 * (3 + len(declared)), dtype="<f4")
    lines = vertices(2, *XYZ, *(f"float {name}" for name in declared))
    (tmp_path / "a.ply").write_bytes(header(*lines) + data.tobytes())
    cloud = read(tmp_path / "a.ply")
    names = [name.removeprefix("scalar_") for name in declared] if len(declared) == 1 else list(declared)
    assert list(cloud.attributes) == names
    write(tmp_path / "b.ply", cloud)
    assert (tmp_path / "b.ply").read_bytes() == (tmp_path / "a.ply").read_bytes()


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian"])
def test_names_of_coordinates_in_upper_case_come_back(tmp_path: Path, encoding: str) -> None:
    lines = vertices(2, "float intensity", "float X", "float Y", "float Z")
    body = np.arange(8, dtype="<f4").tobytes() if encoding != "ascii" else b"0 1 2 3\n4 5 6 7\n"
    (tmp_path / "a.ply").write_bytes(header(*lines, encoding=encoding) + body)
    cloud = read(tmp_path / "a.ply")
    assert cloud.points.tolist() == [[1, 2, 3], [5, 6, 7]]
    assert list(cloud.attributes) == ["intensity"]
    write(tmp_path / "b.ply", cloud, check=True)
    assert (tmp_path / "b.ply").read_bytes() == (tmp_path / "a.ply").read_bytes()
    write(tmp_path / "c.pcd", cloud, format="pcd", check=True)
    assert read(tmp_path / "c.pcd").points.tolist() == cloud.points.tolist()


def test_names_of_coordinates_in_lower_case_come_first(tmp_path: Path) -> None:
    lines = vertices(2, "float X", "float Y", "float Z", *XYZ)
    (tmp_path / "a.ply").write_bytes(header(*lines) + np.arange(12, dtype="<f4").tobytes())
    cloud = read(tmp_path / "a.ply")
    assert cloud.points.tolist() == [[3, 4, 5], [9, 10, 11]]
    assert list(cloud.attributes) == ["X", "Y", "Z"]
    write(tmp_path / "b.ply", cloud, check=True)
    assert (tmp_path / "b.ply").read_bytes() == (tmp_path / "a.ply").read_bytes()


def test_new_columns_of_confidence_get_the_name_that_cloudcompare_needs(tmp_path: Path) -> None:
    cloud = PointCloud(points=np.eye(3), attributes={"confidence": np.ones(3), "label": np.ones(3)})
    write(tmp_path / "a.ply", cloud)
    head = (tmp_path / "a.ply").read_bytes()
    assert b"property double scalar_confidence\nproperty double label\n" in head
    assert list(read(tmp_path / "a.ply").attributes) == ["confidence", "label"]


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
