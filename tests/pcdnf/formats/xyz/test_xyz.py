"""Text files of columns: how they are laid out, what comes back, and one test for each way a file can be wrong."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pcdnf.formats import FormatError, Limits, PlyFlavour, PointCloud, XyzFlavour, read, write
from pcdnf.formats.xyz.layout import MAX_COLUMNS

Refused = Callable[..., FormatError]
Put = Callable[..., Path]


@pytest.fixture
def put(tmp_path: Path) -> Put:
    """Write bytes to a file of some name."""

    def write_bytes(data: bytes | str, name: str = "cloud.xyz") -> Path:
        path = tmp_path / name
        path.write_bytes(data.encode() if isinstance(data, str) else data)
        return path

    return write_bytes


@pytest.fixture
def refused(put: Put) -> Refused:
    """The error that text is refused with."""

    def refuse(data: bytes | str, **limits: Any) -> FormatError:
        with pytest.raises(FormatError) as caught:
            read(put(data), limits=Limits(**limits))
        assert str(caught.value).endswith((".", "…"))
        assert caught.value.hint
        return caught.value

    return refuse


def flavour(cloud: PointCloud) -> XyzFlavour:
    assert isinstance(cloud.flavour, XyzFlavour)
    return cloud.flavour


# How it is laid out


@pytest.mark.parametrize(
    ("text", "separator", "format_"),
    [
        ("1 2 3\n4 5 6\n", " ", "xyz"),
        ("1\t2\t3\n4\t5\t6\n", "\t", "xyz"),
        ("  1   2 3  \r\n\r\n4 5 6", " ", "xyz"),
        ("1,2,3\n4, 5 ,6\n", ",", "csv"),
        ("1;2;3\n\n4;5;6", ";", "csv"),
        ("\ufeff1 2 3\n4 5 6\n", " ", "xyz"),
        ("# a\n1 2 3\n# b\n4 5 6\n// c\n", " ", "xyz"),
        ("2\n1 2 3\n4 5 6\n", " ", "pts"),
        ("x y z\n1 2 3\n4 5 6\n", " ", "xyz"),
        ("1e0 +2. .3e1\n4 5 6\n", " ", "xyz"),
    ],
)
def test_layouts(put: Put, text: str, separator: str, format_: str) -> None:
    cloud = read(put(text))
    np.testing.assert_array_equal(cloud.points, [[1, 2, 3], [4, 5, 6]])
    assert cloud.points.dtype == np.float64
    assert (flavour(cloud).separator, flavour(cloud).format) == (separator, format_)
    assert cloud.warnings == []


def test_only_the_name_tells_that_it_is_text(put: Put) -> None:
    for name in ("cloud", "cloud.ply", "cloud.dat"):
        with pytest.raises(FormatError) as caught:
            read(put("1 2 3\n4 5 6\n", name))
        assert caught.value.code == "unknown_format"
    assert len(read(put("1 2 3\n4 5 6\n", "cloud"), text=True)) == 2
    for name in ("cloud.XYZ", "cloud.txt", "cloud.asc", "cloud.csv", "cloud.pts"):
        assert len(read(put("1 2 3\n4 5 6\n", name))) == 2


def test_first_bytes_count_before_the_name(put: Put) -> None:
    path = put(b"", "cloud.xyz")
    write(path, PointCloud(points=np.eye(3)), format="ply")
    assert isinstance(read(path).flavour, PlyFlavour)


# What comes back


CASES = {
    "plain": "1.5 2 3\n4 5 6\n",
    "comments": "// one\n1.5 2 3 255 0 7\n4 5 6 1 2 3\n",
    "commented names": "# survey\n# X Y Z Scalar_field Nx Ny Nz\n1 2 3 007 0 0 1\n4 5 6 1e3 0 1 0\n",
    "csv": 'X,Y,Z,class,"r",g,b\r\n1,2,3,a word,255,0,0\r\n4,5,6,,0,255,0\r\n',
    "semicolons": "1;2;3;a\n4;5;6;b\n",
    "order": "id;z;y;x\n1;2;3;4\n2;3;4;6\n",
}


@pytest.mark.parametrize("case", CASES)
def test_rows_come_back_as_they_were_spelled(put: Put, case: str) -> None:
    path = put(CASES[case])
    cloud = read(path)
    write(path, cloud)
    before = [line for line in CASES[case].splitlines() if not line.startswith(("#", "/"))]
    after = [line for line in path.read_text().splitlines() if not line.startswith(("#", "/"))]

    def words(line: str) -> list[str]:
        cells = line.replace(";", ",").replace(" ", ",").split(",")
        return [cell.strip('"').removesuffix(".0") for cell in cells]

    assert [words(line) for line in after] == [words(line) for line in before]
    assert (b"\r\n" in path.read_bytes()) == ("\r\n" in CASES[case])
    assert read(path).attributes.keys() == cloud.attributes.keys()


@pytest.mark.parametrize("case", CASES)
def test_a_result_reads_back_and_names_its_normals(put: Put, case: str) -> None:
    path = put(CASES[case])
    cloud = read(path)
    result = cloud.replaced(cloud.points + 1e-9, np.full((2, 3), 0.1, np.float32), metadata={"seed": "1"})
    notes = write(path, result)
    again = read(path)
    np.testing.assert_array_equal(again.points, result.points)
    assert again.normals is not None
    np.testing.assert_allclose(again.normals, 0.1, rtol=1e-7)
    for name, column in cloud.attributes.items():
        np.testing.assert_array_equal(again.attributes[name], column)
    assert again.metadata == ({} if case in ("csv", "order") else {"seed": "1"})
    assert bool(notes) == (case in ("csv", "order"))
    assert again.comments == cloud.comments
    second = path.with_name("second.xyz")
    write(second, again)
    assert second.read_bytes() == path.read_bytes()


def test_columns_without_names_are_reported_and_not_guessed(put: Put) -> None:
    cloud = read(put("1 2 3 0 0 1\n4 5 6 0 0.5 1\n"))
    assert cloud.normals is None
    assert {name: column.tolist() for name, column in cloud.attributes.items()} == {
        "column_4": [b"0", b"0"],
        "column_5": [b"0", b"0.5"],
        "column_6": [b"1", b"1"],
    }
    assert "x, y, z, column_4, column_5, column_6" in cloud.warnings[0]
    assert "x y z nx ny nz" in cloud.warnings[1]


@pytest.mark.parametrize(("cell", "is_colour"), [("255", True), ("256", False), ("-1", False), ("1.0", False)])
def test_six_columns_are_colours_when_all_are_bytes(put: Put, cell: str, is_colour: bool) -> None:
    cloud = read(put(f"1 2 3 0 0 0\n4 5 6 9 9 {cell}\n"))
    assert ("blue" in cloud.attributes) == is_colour
    if is_colour:
        assert cloud.attributes["blue"].dtype == np.uint8


def test_pts_with_intensity_and_colours(put: Put) -> None:
    path = put("2\n1 2 3 -57 255 0 1\n4 5 6 12 0 0 1\n", "cloud.pts")
    cloud = read(path)
    assert [*cloud.attributes] == ["intensity", "red", "green", "blue"]
    write(path, cloud)
    assert path.read_text() == "2\n1.0 2.0 3.0 -57 255 0 1\n4.0 5.0 6.0 12 0 0 1\n"


def test_to_other_formats(put: Put, tmp_path: Path) -> None:
    cloud = read(put("x y z word count share\n1 2 3 a 7 0.5\n4 5 6 b 8 1e-3\n"))
    for format_ in ("ply", "npz", "pcd"):
        notes = write(tmp_path / "out", cloud, format=format_)
        assert ["word" in note for note in notes] == [True]
        again = read(tmp_path / "out")
        assert again.attributes["count"].tolist() == [7, 8]
        assert again.attributes["count"].dtype.kind == "i"
        assert again.attributes["share"].tolist() == [0.5, 0.001]


def test_from_other_formats(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    cloud = PointCloud(
        points=rng.normal(size=(5, 3)) * 1e6,
        normals=rng.normal(size=(5, 3)),
        attributes={
            **{name: np.arange(5, dtype=np.uint16) * 256 for name in ("red", "green", "blue")},
            "two words": np.arange(5, dtype=np.float32) / 3,
            "pair": np.arange(10).reshape(5, 2),
        },
        comments=["a comment"],
        metadata={"seed": "0"},
    )
    for format_ in ("xyz", "csv", "pts"):
        path = tmp_path / f"out.{format_}"
        notes = write(path, cloud, format=format_)
        assert bool(notes) == (format_ != "xyz")
        again = read(path)
        np.testing.assert_array_equal(again.points, cloud.points)
        assert again.flavour.format == format_
        if format_ == "pts":
            continue
        np.testing.assert_array_equal(again.normals, cloud.normals)
        np.testing.assert_array_equal(again.attributes["green"], np.arange(5))
        np.testing.assert_array_equal(
            again.attributes["two_words"].astype(np.float32),
            cloud.attributes["two words"],
        )
        assert again.attributes["pair_1"].tolist() == [b"1", b"3", b"5", b"7", b"9"]
    assert read(tmp_path / "out.xyz").comments == ["a comment"]


def test_words_with_blanks_do_not_become_two_columns(put: Put, tmp_path: Path) -> None:
    cloud = read(put("x,y,z,w\n1,2,3,a b\n4,5,6,c\n"))
    notes = write(tmp_path / "out.xyz", cloud, format="xyz")
    assert "'w'" in notes[0]
    assert read(tmp_path / "out.xyz").attributes == {}


def test_dropped_rows_and_many_blocks(put: Put, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pcdnf.formats.xyz.rows._BLOCK_BYTES", 100)
    points = np.random.default_rng(0).normal(size=(500, 3))
    lines = [" ".join(map(repr, row)) + f" {index}" for index, row in enumerate(points.tolist())]
    lines[7] = "nan 1 2 7"
    lines.insert(20, "# between")
    path = put("\n".join(lines))
    cloud = read(path, limits=Limits(nonfinite="drop"))
    np.testing.assert_array_equal(cloud.points, np.delete(points, 7, axis=0))
    assert cloud.attributes["column_4"][6:8].tolist() == [b"6", b"8"]
    assert cloud.comments == ["between"]


# What is refused


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("\n\n", "too_few_points"),
        ("# nothing\n", "too_few_points"),
        ("1 2\n3 4\n", "bad_shape"),
        ("1\n2\n3\n", "bad_shape"),
        ("1 2 3\n4 5\n", "bad_value"),
        ("1 2 3\n4 5 6 7\n", "bad_value"),
        ("1,2,3\n4 5 6\n", "bad_value"),
        ("1,5;2,5;3,5\n1,5;2,5;3,6\n", "missing_coordinates"),
        ("1 2 3\n4 5 x\n", "bad_value"),
        ("1 2 3\n4 5 1_0\n", "bad_value"),
        ("1 2 3\n4 5 0x10\n", "bad_value"),
        ("1,2,3\n4,,6\n", "bad_value"),
        ("1 2 3\n4 5 6 # six\n", "bad_value"),
        ("1 2 3\n4 5 " + "6" * 65 + "\n", "bad_value"),
        ("1 2 3\n4 5 \0\n", "bad_value"),
        ("a b c\n1 2 3\n", "missing_coordinates"),
        ("x y z\n", "too_few_points"),
        ("x y z w\n1 2 3\n", "bad_value"),
        ("x y z Z\n1 2 3 4\n", "duplicate_property"),
        ("4\n1 2 3\n4 5 6\n", "truncated"),
        ("1\n1 2 3\n4 5 6\n7 8 9\n", "trailing_data"),
        ("nan 2 3\n4 5 1e400\n", "too_few_points"),
        ("1 2 3\n1 2 3\n", "zero_extent"),
        ("# " + "a" * 1001 + "\n1 2 3\n4 5 6\n", "header_too_long"),
        ("# a line of sixteen\n" * 4000 + "1 2 3\n4 5 6\n", "header_too_long"),
        ("1 2 3\n4 5 6\n" + "# a line of sixteen\n" * 4000, "header_too_long"),
        ("1 2 3\n4 5 6\n" + "7 " * 40_000, "bad_value"),
        ("9" * 100_000, "bad_value"),
        (" ".join("1" for _ in range(MAX_COLUMNS + 1)) + "\n", "too_many_elements"),
        ("99999999999999999\n1 2 3\n", "too_many_points"),
    ],
)
def test_refusals(refused: Refused, text: str, code: str) -> None:
    assert refused(text).code == code


@pytest.mark.parametrize("data", ["1 2 3\n4 5 6\n".encode("utf-16"), b"\x89PNG\r\n\x1a\n\0\0\0", bytes(200)])
def test_what_is_not_text(refused: Refused, data: bytes) -> None:
    assert refused(data).code in ("bad_value", "missing_coordinates", "unknown_format")


def test_messages_name_the_row(refused: Refused) -> None:
    error = refused("1 2 3\n# comment\n\n4 5 6\n7 8 x9\n")
    assert "Row 2 " in str(error)
    assert "'x9'" in str(error)
    assert "column 3" in str(error)


def test_limits_of_points(refused: Refused, put: Put) -> None:
    text = "".join(f"{i} 0 0\n" for i in range(5))
    assert refused(text, max_points=4).code == "too_many_points"
    assert refused(text, minimum_points=6).code == "too_few_points"
    assert len(read(put(text), limits=Limits(max_points=5, minimum_points=5))) == 5


def test_too_many_columns_to_write(tmp_path: Path) -> None:
    cloud = PointCloud(points=np.eye(3), attributes={"many": np.zeros((3, 254))})
    with pytest.raises(FormatError) as caught:
        write(tmp_path / "out", cloud, format="xyz")
    assert caught.value.code == "cannot_store"


def test_names_that_differ_by_case_or_blanks_only_get_numbers(tmp_path: Path) -> None:
    names = ("Intensity", "intensity", "X", "a b", "a_b", "")
    columns = {name: np.full(3, number) for number, name in enumerate(names)}
    for ending in ("xyz", "csv", "npz"):
        write(tmp_path / "a", PointCloud(points=np.eye(3), attributes=columns), format=ending, check=True)
        found = read(tmp_path / "a", text=ending != "npz").attributes
        assert [int(column[0]) for column in found.values()] == list(range(6)), ending
