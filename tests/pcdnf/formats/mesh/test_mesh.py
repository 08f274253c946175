"""Meshes: their vertices are a cloud, their faces come back unchanged in a PLY, and nothing is dropped silently."""

from __future__ import annotations

import gzip
import struct
from pathlib import Path

import numpy as np
import pytest

from pcdnf.formats import FormatError, Limits, read, write

POINTS = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0.5, 0.5, 1)]
FACES = [(0, 1, 2, 3), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)]


def obj(*, normals: bool = False, colours: bool = False, relative: bool = False) -> bytes:
    lines = ["# a pyramid", "mtllib a.mtl", "o pyramid"]
    for number, point in enumerate(POINTS):
        colour = f" {number / 4} 0 1" if colours else ""
        lines += [f"v {point[0]} {point[1]} {point[2]}{colour}", *(["vn 0 0 1"] if normals else [])]
    for face in FACES:
        shift = -len(POINTS) if relative else 1
        corners = [f"{i + shift}//{i + shift}" if normals else str(i + shift) for i in face]
        lines.append("f " + " ".join(corners))
    return ("\n".join(lines) + "\n").encode()


def off(head: str = "OFF", more: str = "") -> bytes:
    lines = [head, f"{len(POINTS)} {len(FACES)} 0  # counts", *(f"{x} {y} {z}{more}" for x, y, z in POINTS)]
    lines += [f"{len(face)} {' '.join(map(str, face))}" for face in FACES]
    return ("\n".join(lines) + "\n").encode()


def triangles() -> list[tuple[int, int, int]]:
    return [(face[0], face[i], face[i + 1]) for face in FACES for i in range(1, len(face) - 1)]


def stl() -> bytes:
    facets = [struct.pack("<12fH", 0, 0, 0, *(v for i in one for v in POINTS[i]), 0) for one in triangles()]
    return b"solid is no word here".ljust(80, b" ") + struct.pack("<I", len(facets)) + b"".join(facets)


def stl_text() -> bytes:
    lines = ["solid pyramid"]
    for one in triangles():
        corners = ["  vertex {} {} {}".format(*POINTS[i]) for i in one]
        lines += ["facet normal 0 0 0", " outer loop", *corners, " endloop", "endfacet"]
    return "\n".join([*lines, "endsolid pyramid", ""]).encode()


def faces_of(path: Path) -> list[tuple[int, ...]]:
    """The faces of a binary PLY of ours, read by nothing of ours."""
    head, _, body = path.read_bytes().partition(b"end_header\n")
    lines = head.decode().splitlines()
    count = int(next(line for line in lines if line.startswith("element face")).split()[2])
    assert "property list uchar int vertex_indices" in lines
    vertices = int(next(line for line in lines if line.startswith("element vertex")).split()[2])
    sizes = {"float": 4, "double": 8, "uchar": 1}
    stride = sum(sizes[line.split()[1]] for line in lines if line.startswith("property") and "list" not in line)
    at, faces = vertices * stride, []
    for _ in range(count):
        faces.append(struct.unpack_from(f"<{body[at]}i", body, at + 1))
        at += 1 + 4 * body[at]
    assert at == len(body)
    return faces


@pytest.mark.parametrize(
    ("name", "data", "faces"),
    [
        ("a.obj", obj(), FACES),
        ("a.obj", obj(normals=True, colours=True), FACES),
        ("a.obj", obj(relative=True), FACES),
        ("a.obj", obj().replace(b"\n", b"\r\n"), FACES),
        ("a.off", off(), FACES),
        ("a.off", off("NOFF", " 0 0 1"), FACES),
        ("a.off", off("COFF", " 255 0 9 255"), FACES),
        ("a.stl", stl(), triangles()),
        ("a.stl", stl_text(), triangles()),
        ("a", obj(), FACES),
    ],
)
def test_vertices_are_a_cloud_and_faces_come_back_in_a_ply(
    tmp_path: Path, name: str, data: bytes, faces: list[tuple[int, ...]]
) -> None:
    (tmp_path / name).write_bytes(data)
    cloud = read(tmp_path / name)
    np.testing.assert_allclose(cloud.points, POINTS)
    assert "results are PLY, with its faces unchanged" in cloud.warnings[0]
    write(tmp_path / "b.ply", cloud.replaced(cloud.points + 1, np.tile([0, 0, 1.0], (5, 1))), check=True)
    assert faces_of(tmp_path / "b.ply") == faces
    np.testing.assert_allclose(read(tmp_path / "b.ply").points, np.array(POINTS) + 1)


def test_colours_and_normals_of_vertices_are_read(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_bytes(obj(normals=True, colours=True))
    cloud = read(tmp_path / "a.obj")
    np.testing.assert_allclose(cloud.attributes["red"], [0, 0.25, 0.5, 0.75, 1])
    np.testing.assert_array_equal(cloud.normals, np.tile([0, 0, 1], (5, 1)))
    assert cloud.comments == ["a pyramid"]


@pytest.mark.parametrize(("head", "values"), [("CNOFF", " 0 1 0 255 0 9 255"), ("NCOFF", " 255 0 9 255 0 1 0")])
def test_normals_and_colours_of_an_off_come_as_geomview_and_as_meshlab_order_them(
    tmp_path: Path, head: str, values: str
) -> None:
    (tmp_path / "a.off").write_bytes(off(head, values))
    cloud = read(tmp_path / "a.off")
    assert cloud.attributes["red"].dtype == np.uint8
    assert [int(cloud.attributes[name][0]) for name in ("red", "green", "blue")] == [255, 0, 9]
    np.testing.assert_array_equal(cloud.normals, np.tile([0, 1, 0], (5, 1)))


def test_what_a_ply_cannot_hold_is_said(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_bytes(obj(normals=True).replace(b"//1", b"/7/2") + b"vt 0 0\nl 1 2\n")
    assert read(tmp_path / "a.obj").warnings[1] == (
        "Left out were: materials, groups, texture coordinates, lines, normals of corners."
    )
    (tmp_path / "a.stl").write_bytes(stl())
    assert "normals of triangles" in read(tmp_path / "a.stl").warnings[1]
    notes = write(tmp_path / "a.xyz", read(tmp_path / "a.stl"), format="xyz")
    assert any("left out were: 'face'" in note for note in notes)


@pytest.mark.parametrize(
    ("data", "code", "word"),
    [
        (obj() + b"f 1 2 9\n", "bad_value", "Face 5 has a corner that is not one"),
        (obj() + b"f 1 2 -9\n", "bad_value", "Face 5 has a corner that is not one"),
        (obj() + b"f 1 2\n", "bad_value", "2 corners"),
        (obj() + b"f 1 2 x\n", "bad_value", "not a number"),
        (obj() + b"v 1 2\n", "bad_value", "Vertex 5 has 2 values"),
        (obj().replace(b"v 1 0 0", b"v 1 0 z"), "bad_value", "not numbers"),
        (obj().replace(b"v 1 0 0", b"v 1 0 1_0"), "bad_value", "not numbers"),
        (off().replace(b"5 5 0", b"6 5 0"), "truncated", "it has 10 rows"),
        (off().replace(b"5 5 0", b"5 4 0"), "trailing_data", "it has 10 rows"),
        (off().replace(b"5 5 0", b"5 x 0"), "bad_header", "whole numbers"),
        (off().replace(b"4 0 1 2 3", b"9 0 1 2 3"), "bad_value", "number of its corners"),
        (off().replace(b"4 0 1 2 3", b"4 0 1 2 7"), "bad_value", "Face 0 has a corner"),
        (off("COFF"), "bad_value", "first word"),
        (stl_text().replace(b"vertex 0.5", b"vertex x", 1), "bad_value", "not numbers"),
        (stl_text().replace(b"  vertex 0.5 0.5 1\n", b"", 1), "bad_value", "three vertices"),
    ],
)
def test_refusals_name_what_is_wrong(tmp_path: Path, data: bytes, code: str, word: str) -> None:
    (tmp_path / "a").write_bytes(data)
    with pytest.raises(FormatError, match=word) as caught:
        read(tmp_path / "a")
    assert caught.value.code == code
    assert "PLY" in str(caught.value.hint)


def test_limits_hold_for_meshes(tmp_path: Path) -> None:
    for data in (obj(), off(), stl(), stl_text()):
        (tmp_path / "a").write_bytes(data)
        for limits, code in ((Limits(max_points=4), "too_many_points"), (Limits(minimum_points=6), "too_few_points")):
            with pytest.raises(FormatError) as caught:
                read(tmp_path / "a", limits=limits)
            assert caught.value.code == code


@pytest.mark.parametrize(
    ("name", "data", "word"),
    [
        ("a.glb", b"glTF\2\0\0\0", "GLB"),
        ("a.gltf", b'{"asset": {}}', "glTF"),
        ("a.spz", gzip.compress(b"NGSP\2\0\0\0", mtime=0), "SPZ"),
        ("a.splat", bytes(64), "splats"),
        ("a.off", b"OFF BINARY\n", "binary OFF"),
        ("a.fbx", b"Kaydara FBX Binary  \0", "FBX"),
        ("a.rcp", b"\1\2\3\4", "ReCap"),
    ],
)
def test_what_is_not_read_says_what_to_do(tmp_path: Path, name: str, data: bytes, word: str) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(FormatError, match=word) as caught:
        read(tmp_path / name)
    assert caught.value.hint == "Export its points as PLY or LAZ."
