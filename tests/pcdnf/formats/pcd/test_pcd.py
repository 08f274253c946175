"""PCD: what comes back in each of its encodings, and one test for each way a file can be wrong."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pcdnf.formats import FormatError, Limits, PcdFlavour, PointCloud, read, write
from pcdnf.formats.pcd.columns import packed, unpacked
from pcdnf.formats.pcd.lzf import decompress
from pcdnf.formats.pcd.lzf_compress import compress

ENCODINGS = ["ascii", "binary", "binary_compressed"]
POINTS = np.random.default_rng(0).normal(size=(6, 3))
Refused = Callable[..., FormatError]


def header(encoding: str = "binary", count: object = 4, **lines: str) -> bytes:
    given = {
        "VERSION": ".7",
        "FIELDS": "x y z",
        "SIZE": "4 4 4",
        "TYPE": "F F F",
        "COUNT": "1 1 1",
        "WIDTH": str(count),
        "HEIGHT": "1",
        "VIEWPOINT": "0 0 0 1 0 0 0",
        "POINTS": str(count),
        "DATA": encoding,
    } | lines
    text = "# .PCD v.7 - Point Cloud Data file format\n"
    return (text + "".join(f"{key} {value}\n" for key, value in given.items() if value)).encode()


def floats(count: int) -> bytes:
    return np.arange(3 * count, dtype="<f4").tobytes()


# What comes back


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_everything_comes_back_byte_for_byte(tmp_path: Path, encoding: str) -> None:
    cloud = PointCloud(
        points=POINTS,
        normals=POINTS.astype(np.float32).astype(np.float64),
        attributes={
            "red": np.arange(6, dtype=np.uint8),
            "green": np.full(6, 255, np.uint8),
            "blue": np.arange(6, dtype=np.uint8) * 50,
            "intensity": np.linspace(0, 1, 6, dtype=np.float32),
            "stamp": np.arange(6, dtype=np.int64) + 10**12,
            "histogram": np.arange(12, dtype=np.uint16).reshape(6, 2),
        },
        comments=["survey 12"],
        metadata={"device": "cpu"},
        flavour=PcdFlavour(
            encoding,
            (
                *((name, "f8", 1) for name in "xyz"),
                ("_", "u1", 3),
                ("rgb", "f4", 1),
                ("intensity", "f4", 1),
                ("_", "u1", 1),
            ),
            width=3,
            height=2,
            viewpoint="1 2 3 1 0 0 0",
            packed="rgb",
        ),
    )
    first, second = tmp_path / "a.pcd", tmp_path / "b.pcd"
    assert write(first, cloud) == []
    again = read(first)
    np.testing.assert_array_equal(again.points, POINTS)
    np.testing.assert_array_equal(again.normals, cloud.normals)
    for name, column in cloud.attributes.items():
        np.testing.assert_array_equal(again.attributes[name], column)
        assert again.attributes[name].dtype == column.dtype
    assert (again.comments, again.metadata) == (["survey 12"], {"device": "cpu"})
    assert isinstance(again.flavour, PcdFlavour)
    assert (again.flavour.encoding, again.flavour.width, again.flavour.height) == (encoding, 3, 2)
    assert again.flavour.viewpoint == "1 2 3 1 0 0 0"
    write(second, again)
    assert second.read_bytes() == first.read_bytes()


def test_a_file_as_pcl_writes_it(tmp_path: Path) -> None:
    colours = [(255, 0, 1), (2, 128, 3)]
    values = [struct.unpack("<f", struct.pack("<I", r << 16 | g << 8 | b))[0] for r, g, b in colours]
    lines = {"FIELDS": "x y z rgb", "SIZE": "4 4 4 4", "TYPE": "F F F F", "COUNT": "1 1 1 1"}
    text = "".join(f"{row} 0.5 1 {value:.9g}\n" for row, value in enumerate(values))
    path = tmp_path / "cloud.pcd"
    path.write_bytes(header("ascii", 2, **lines) + text.encode())
    cloud = read(path)
    np.testing.assert_array_equal(cloud.points, [[0, 0.5, 1], [1, 0.5, 1]])
    np.testing.assert_array_equal(np.stack([cloud.attributes[name] for name in ("red", "green", "blue")], 1), colours)
    write(path, cloud.replaced(cloud.points + 1, np.ones((2, 3))))
    assert b"FIELDS x y z rgb normal_x normal_y normal_z\n" in path.read_bytes()
    np.testing.assert_array_equal(read(path).attributes["green"], [0, 128])
    write(path, cloud, format="ply")
    assert b"property uchar red" in path.read_bytes()


def test_optional_lines_and_zeros_at_the_end(tmp_path: Path) -> None:
    path = tmp_path / "cloud.pcd"
    path.write_bytes(header(COUNT="", VIEWPOINT="", POINTS="", VERSION="") + floats(4) + bytes(4096))
    np.testing.assert_array_equal(read(path).points, np.arange(12).reshape(4, 3))


def test_holes_of_a_grid(tmp_path: Path) -> None:
    points = np.arange(18, dtype="<f4").reshape(6, 3)
    points[2] = np.nan
    data = header(count=6, WIDTH="3", HEIGHT="2") + points.tobytes()
    path = tmp_path / "in.pcd"
    path.write_bytes(data)
    kept = read(path)
    assert len(kept) == 5
    write(tmp_path / "kept.pcd", kept.replaced(kept.points, None, metadata={}))
    assert (tmp_path / "kept.pcd").read_bytes()[-72:] == points.tobytes()
    assert b"WIDTH 3\nHEIGHT 2\n" in (tmp_path / "kept.pcd").read_bytes()
    cloud = read(path, limits=Limits(nonfinite="drop"))
    notes = write(tmp_path / "out.pcd", cloud)
    assert "grid" in notes[0]
    assert b"WIDTH 5\nHEIGHT 1\n" in (tmp_path / "out.pcd").read_bytes()


def test_integer_coordinates(tmp_path: Path) -> None:
    path = tmp_path / "cloud.pcd"
    path.write_bytes(header("ascii", 2, TYPE="I I I") + b"1 2 3\n4 5 6\n")
    cloud = read(path)
    assert cloud.points.dtype == np.float64
    assert "integers" in cloud.warnings[0]
    write(path, cloud.replaced(cloud.points + 0.5, None))
    np.testing.assert_array_equal(read(path).points, [[1.5, 2.5, 3.5], [4.5, 5.5, 6.5]])


def test_from_other_formats(tmp_path: Path) -> None:
    cloud = PointCloud(
        points=POINTS,
        attributes={
            **{name: np.arange(6, dtype=np.uint16) * 257 for name in ("red", "green", "blue")},
            "a name": np.ones(6, bool),
            "half": np.ones(6, np.float16),
            "word": np.array([b"a"] * 6),
        },
        extras={"origin": np.zeros(3)},
    )
    notes = write(tmp_path / "out.pcd", cloud, format="pcd")
    assert ["word" in notes[0], "origin" in notes[1], "float32" in notes[2], len(notes)] == [True, True, True, 3]
    again = read(tmp_path / "out.pcd")
    assert b"FIELDS x y z rgb a_name half\n" in (tmp_path / "out.pcd").read_bytes()
    np.testing.assert_array_equal(again.attributes["blue"], np.arange(6))
    assert again.attributes["half"].dtype == np.float32


def test_doubles_of_other_formats_are_stored_as_most_programs_read_them(tmp_path: Path) -> None:
    near = np.random.default_rng(0).normal(size=(300, 3))
    write(tmp_path / "near.pcd", PointCloud(points=near), format="pcd", check=True)
    assert b"FIELDS x y z\nSIZE 4 4 4\n" in (tmp_path / "near.pcd").read_bytes()
    far = near + np.array([500_000, 5_400_000, 100])
    (note,) = write(tmp_path / "far.pcd", PointCloud(points=far), format="pcd", check=True)
    assert "x_rest" in note
    cloud = read(tmp_path / "far.pcd")
    assert cloud.points.dtype == np.float64
    np.testing.assert_allclose(cloud.points, far, atol=2e-8, rtol=0)
    write(tmp_path / "again.pcd", cloud.replaced(cloud.points + 0.001, None), check=True)
    np.testing.assert_allclose(read(tmp_path / "again.pcd").points, far + 0.001, atol=4e-8, rtol=0)
    write(tmp_path / "doubles.pcd", PointCloud(points=far, flavour=PcdFlavour()))
    np.testing.assert_array_equal(read(tmp_path / "doubles.pcd").points, far)
    huge = near * 1e200
    write(tmp_path / "huge.pcd", PointCloud(points=huge), format="pcd")
    assert b"SIZE 8 8 8\n" in (tmp_path / "huge.pcd").read_bytes()


def test_normals_of_other_formats_are_float32_which_pcl_finds(tmp_path: Path) -> None:
    points = np.random.default_rng(0).normal(size=(60, 3))
    unit = points / np.linalg.norm(points, axis=1, keepdims=True)
    write(tmp_path / "a.pcd", PointCloud(points=points, normals=unit), format="pcd")
    again = read(tmp_path / "a.pcd")
    assert again.normals is not None
    assert again.normals.dtype == np.float32
    np.testing.assert_allclose(again.normals, unit, atol=1e-6)


def test_names_of_fields_in_capitals(tmp_path: Path) -> None:
    path = tmp_path / "a.pcd"
    path.write_bytes(header(FIELDS="X Y Z") + floats(4))
    cloud = read(path)
    np.testing.assert_array_equal(cloud.points, np.arange(12).reshape(4, 3))
    write(path, cloud.replaced(cloud.points + 1, None))
    assert b"FIELDS X Y Z\n" in path.read_bytes()
    np.testing.assert_array_equal(read(path).points, cloud.points + 1)


def test_colours_pack_and_unpack() -> None:
    values = np.random.default_rng(0).integers(0, 2**32, 50, dtype=np.uint32)
    parts = unpacked(values, alpha=True)
    table = np.stack([parts[name] for name in ("red", "green", "blue")], 1)
    np.testing.assert_array_equal(packed(table, parts["alpha"]).view("<u4"), values)
    assert parts["red"][0] == values[0] >> 16 & 255


# LZF


@settings(deadline=None)  # the first call compiles
@given(st.binary(max_size=300), st.integers(1, 40))
def test_lzf_there_and_back(data: bytes, times: int) -> None:
    whole = data * times
    small = compress(np.frombuffer(whole, np.uint8))
    back = decompress(small, len(whole))
    assert back is not None
    assert back == whole
    assert len(small) <= len(whole) + len(whole) // 32 + 1


def test_lzf_known_bytes() -> None:
    packed_bytes = b"\x02abc\x60\x02\x00d"  # three literals, 5 bytes from 3 back, one literal
    back = decompress(packed_bytes, 9)
    assert back is not None
    assert back == b"abcabcabd"
    assert len(compress(np.zeros(100_000, np.uint8))) < 100_000 / 80


@settings(deadline=None)
@given(st.binary(max_size=60), st.integers(0, 100))
def test_lzf_survives_anything(data: bytes, size: int) -> None:
    back = decompress(data, size)
    assert back is None or len(back) == size


# What is refused


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"FIELDS": ""}, "bad_header"),
        ({"HEIGHT": ""}, "bad_header"),
        ({"VERSION": "0.8"}, "bad_header"),
        ({"WIDTH": "-4"}, "bad_header"),
        ({"WIDTH": "4.0"}, "bad_header"),
        ({"WIDTH": "9" * 18, "POINTS": ""}, "too_many_points"),
        ({"WIDTH": "9" * 20}, "bad_header"),
        ({"WIDTH": "9" * 19, "HEIGHT": "9" * 19, "POINTS": ""}, "bad_header"),
        ({"POINTS": "5"}, "bad_header"),
        ({"WIDTH": "0", "POINTS": "0"}, "too_few_points"),
        ({"VIEWPOINT": "0 0 0"}, "bad_header"),
        ({"VIEWPOINT": "0 0 0 1 0 0 x"}, "bad_header"),
        ({"DATA": "zipped"}, "bad_header"),
        ({"DATA": "binary ascii"}, "bad_header"),
        ({"EXTRA": "1"}, "bad_header"),
        ({"SIZE": "4 4"}, "bad_header"),
        ({"SIZE": "4 4 3"}, "unsupported_type"),
        ({"TYPE": "F F X"}, "unsupported_type"),
        ({"SIZE": "4 4 2"}, "unsupported_type"),
        ({"COUNT": "1 1 0"}, "bad_header"),
        ({"COUNT": "1 1 9999"}, "too_many_elements"),
        ({"COUNT": "1 1 2"}, "missing_coordinates"),
        ({"FIELDS": "x y y"}, "duplicate_property"),
        ({"FIELDS": "x y w"}, "missing_coordinates"),
        ({"FIELDS": "x y é"}, "bad_header"),
    ],
)
def test_bad_headers(refused: Refused, changes: dict[str, str], code: str) -> None:
    lines = {key: value for key, value in changes.items() if key != "DATA"}
    data = header(changes.get("DATA", "binary"), **lines) if "EXTRA" not in changes else b"# .PCD\nEXTRA 1\n" + header()
    assert refused(data + floats(4)).code == code


def test_too_many_fields(refused: Refused) -> None:
    names = ["x", "y", "z", *(f"f{i}" for i in range(254))]
    ones = " ".join("1" for _ in names)
    lines = {"FIELDS": " ".join(names), "SIZE": ones, "TYPE": " ".join("U" for _ in names), "COUNT": ones}
    error = refused(header(**lines) + bytes(257 * 4))
    assert (error.code, error.limit, error.actual) == ("too_many_elements", 256, 257)


def test_long_lines_long_headers_and_no_end(refused: Refused) -> None:
    assert refused(b"# .PCD\n#" + b"a" * 1001 + b"\n" + header()).code == "header_too_long"
    assert refused(b"# .PCD\n" + (b"#" + b"a" * 900 + b"\n") * 80 + header()).code == "header_too_long"
    assert refused(header()[:60]).code == "bad_header"
    assert refused(header()[:-12] + b"WIDTH 3\nDATA binary\n").code == "bad_header"


@pytest.mark.parametrize("encoding", ["binary", "ascii"])
def test_counts_and_bytes(refused: Refused, encoding: str) -> None:
    body = floats(4) if encoding == "binary" else b"0 1 2\n3 4 5\n6 7 8\n9 1 1\n"
    for cut in (2, 11, 17):
        assert refused(header(encoding) + body[:-cut]).code in ("truncated", "bad_value")
    assert refused(header(encoding) + body + b"1 2 3\n").code == "trailing_data"
    error = refused(header(encoding, 10_000_000_000) + body, max_points=2**40)
    assert error.code == "truncated"
    assert error.actual == len(header(encoding, 10_000_000_000) + body)


@pytest.mark.parametrize("text", [b"1 2\n3 4 50\n", b"1 2 x\n3 4 5\n", b"1 2 " + b"3" * 65 + b"\n3 4 5\n"])
def test_bad_text(refused: Refused, text: bytes) -> None:
    assert refused(header("ascii", 2) + text).code == "bad_value"


def test_long_integers_in_text_are_exact_or_refused(refused: Refused, tmp_path: Path) -> None:
    lines = {"FIELDS": "x y z t", "SIZE": "4 4 4 8", "TYPE": "F F F U", "COUNT": "1 1 1 1"}
    (tmp_path / "exact.pcd").write_bytes(header("ascii", 2, **lines) + b"1 2 3 9007199254740992\n1 2 4 0\n")
    assert read(tmp_path / "exact.pcd").attributes["t"].tolist() == [2**53, 0]
    for value in (b"9007199254740994", b"-1", b"0.5"):
        assert refused(header("ascii", 2, **lines) + b"1 2 3 " + value + b"\n1 2 4 0\n").code == "bad_value"


def _compressed(data: bytes, packed_size: int | None = None, size: int | None = None) -> bytes:
    small = compress(np.frombuffer(data, np.uint8))
    sizes = struct.pack("<II", packed_size or len(small), len(data) if size is None else size)
    return header("binary_compressed") + sizes + small


def test_compressed_data_that_lies(refused: Refused) -> None:
    data = floats(4)
    assert refused(_compressed(data, size=47)).code == "bad_header"
    assert refused(_compressed(data, packed_size=10_000)).code == "truncated"
    assert refused(_compressed(data) + b"x").code == "trailing_data"
    assert refused(header("binary_compressed") + b"1234567").code == "truncated"
    damaged = bytearray(_compressed(data))
    damaged[len(header("binary_compressed")) + 8] = 0xFF
    assert refused(bytes(damaged)).code == "corrupt_archive"
    assert refused(_compressed(data), max_bytes=len(_compressed(data)) - 1).code == "file_too_large"
    many = header("binary_compressed", 10**8) + struct.pack("<II", 5, 12 * 10**8) + b"\x00a\xe0\xff\x00"
    assert refused(many).code == "corrupt_archive"
