"""Columns of text as programs write them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pcdnf.formats import FormatError, PointCloud, read, write

COUNT = 50
POINTS = np.random.default_rng(0).normal(size=(COUNT, 3)).round(4)
UP = np.tile([0.6, 0, 0.8], (COUNT, 1))
Put = Callable[[str, str], Path]


@pytest.fixture
def put(tmp_path: Path) -> Put:
    def put(name: str, text: str) -> Path:
        path = tmp_path / name
        path.write_text(text)
        return path

    return put


def rows(*columns: object, head: str = "") -> str:
    """Rows of the points between columns: a string stands for itself, ``...`` for x y z."""
    lines = []
    for number, point in enumerate(POINTS.tolist()):
        cells = [" ".join(map(repr, point)) if column is ... else str(column).replace("#", str(number))
                 for column in columns]  # fmt: skip
        lines.append(" ".join(cells))
    return head + "\n".join(lines) + "\n"


def test_normals_never_land_where_a_pts_has_colours(put: Put, tmp_path: Path) -> None:
    for columns in ((...,), (..., "-900"), (..., "-900 1 2 3")):
        cloud = read(put("a.pts", rows(*columns, head=f"{COUNT}\n")))
        notes = write(tmp_path / "b.pts", cloud.replaced(cloud.points, UP), check=True)
        assert "PTS has no place for normals" in notes[0]
        assert "PLY" in notes[0], "one that has"
        assert (tmp_path / "b.pts").read_text() == (tmp_path / "a.pts").read_text()


def test_a_count_beside_names_is_no_pts(put: Put, tmp_path: Path) -> None:
    path = put("a.txt", rows(..., "0.5 0 0 1", head=f"//X Y Z Rf Nx Ny Nz\n{COUNT}\n"))
    cloud = read(path)
    assert write(tmp_path / "b.txt", cloud.replaced(cloud.points, UP), check=True) == []
    again = read(tmp_path / "b.txt")
    np.testing.assert_array_equal(again.normals, UP)  # type: ignore[arg-type]
    assert "Rf" in again.attributes


def test_a_new_pts_has_the_columns_that_readers_expect(tmp_path: Path) -> None:
    cloud = PointCloud(
        points=POINTS,
        normals=UP,
        attributes={
            "id": np.arange(COUNT),
            **{name: np.full(COUNT, 1.0) for name in ("r", "g", "b")},
            "scalar_Intensity": np.full(COUNT, 7),
        },
    )
    notes = write(tmp_path / "a.pts", cloud, format="pts")
    assert any("'id'" in note for note in notes)
    assert (tmp_path / "a.pts").read_text().splitlines()[1].split()[3:] == ["7", "255", "255", "255"]


def test_scans_of_a_pts_are_joined(put: Put) -> None:
    cloud = read(put("a.pts", rows(..., "5", head=f"{COUNT}\n") + rows(..., "6", head=f"{COUNT}\n")))
    assert len(cloud) == 2 * COUNT
    assert "2 scans" in cloud.warnings[-1]
    with pytest.raises(FormatError, match="100 points"):
        read(put("b.pts", rows(..., head=f"{COUNT}\n") + f"{COUNT}\n1 2 3\n"))


@pytest.mark.parametrize("declared", [COUNT - 1, COUNT + 1])
def test_a_count_that_is_one_off_is_a_warning(put: Put, declared: int) -> None:
    cloud = read(put("a.pts", rows(..., "1", head=f"{declared}\n")))
    assert len(cloud) == COUNT
    assert f"declares {declared} points" in cloud.warnings[-1]


COLMAP = "# 3D point list\n#   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n"


def test_ids_of_colmap_are_not_coordinates(put: Put, tmp_path: Path) -> None:
    path = put("points3D.txt", rows("7#", ..., "10 20 30 0.5 1 5", head=COLMAP))
    cloud = read(path)
    np.testing.assert_array_equal(cloud.points, POINTS)
    assert cloud.attributes["green"].tolist() == [20] * COUNT
    write(tmp_path / "b.txt", cloud.replaced(cloud.points + 1, None))
    lines = [line.split() for line in (tmp_path / "b.txt").read_text().splitlines() if line[0] != "#"]
    assert [line[0] for line in lines] == [f"7{number}" for number in range(COUNT)]
    np.testing.assert_allclose([float(line[1]) for line in lines], POINTS[:, 0] + 1)


def test_tracks_of_many_lengths_are_refused_with_the_cause(put: Put) -> None:
    with pytest.raises(FormatError) as caught:
        read(put("points3D.txt", COLMAP + "1 0 0 0 1 2 3 0.5 4 9\n2 1 1 1 1 2 3 0.5 4 9 4 9\n"))
    assert "COLMAP" in str(caught.value.hint)


@pytest.mark.parametrize("first", [0, 1])
def test_a_column_that_counts_the_rows_is_not_x(put: Put, first: int) -> None:
    text = "".join(f"{number + first} {x} {y} {z}\n" for number, (x, y, z) in enumerate(POINTS.tolist()))
    cloud = read(put("a.xyz", text))
    np.testing.assert_array_equal(cloud.points, POINTS)
    assert any("counts the rows" in warning for warning in cloud.warnings)
    assert cloud.attributes["number"].tolist() == list(range(first, COUNT + first))


def test_comments_of_octave(put: Put) -> None:
    cloud = read(put("a.xyz", rows(..., head="% x y z\n")))
    np.testing.assert_array_equal(cloud.points, POINTS)


def test_columns_that_the_ending_stands_for(put: Put, tmp_path: Path) -> None:
    cloud = read(put("a.xyzn", rows(..., "0 0 1")))
    np.testing.assert_array_equal(cloud.normals, np.tile([0.0, 0, 1], (COUNT, 1)))  # type: ignore[arg-type]
    coloured = read(put("a.xyzrgb", rows(..., "1 0.5 0")))
    write(tmp_path / "a.ply", coloured, format="ply")
    assert read(tmp_path / "a.ply").attributes["green"].tolist() == [128] * COUNT


def test_a_table_of_a_hundred_columns(put: Put, tmp_path: Path) -> None:
    names = ",".join(["x", "y", "z", *(f"band{number}" for number in range(100))])
    text = names + "\n" + rows(..., *["0.5"] * 100).replace(" ", ",")
    cloud = read(put("a.csv", text))
    assert len(cloud.attributes) == 100
    write(tmp_path / "b.csv", cloud, check=True)
    assert (tmp_path / "b.csv").read_text() == text


def test_a_ptx_under_another_name_is_not_taken_for_columns(put: Put) -> None:
    for name in ("a.txt", "a.pts"):
        with pytest.raises(FormatError) as caught:
            read(put(name, rows(..., "0.5", head="10\n5\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n")))
        assert ".ptx" in str(caught.value.hint)
