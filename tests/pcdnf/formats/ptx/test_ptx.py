"""PTX: scans on grids with poses, in and out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pcdnf.formats import FormatError, PointCloud, PtxFlavour, read, write

TURN = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
SHIFT = np.array([500_000.0, 5_400_000, 10])
COLUMNS, ROWS = 4, 5
LOCAL = np.random.default_rng(0).normal(size=(COLUMNS * ROWS, 3)).round(5)
LOCAL[3] = 0
WITH_RETURN = [row for row in range(20) if row != 3]


def scan(shift: np.ndarray[tuple[int], np.dtype[np.float64]] = SHIFT, *, colours: bool = True) -> str:
    lines = [str(COLUMNS), str(ROWS), " ".join(map(str, shift)), *("1 0 0", "0 1 0", "0 0 1")]
    lines += [" ".join(map(str, [*row, 0])) for row in TURN.tolist()]
    lines.append(" ".join(map(str, [*shift, 1])))
    for number, point in enumerate(LOCAL.tolist()):
        tail = f" {number} 20 30" if colours else ""
        lines.append(" ".join(map(repr, point)) + f" {number / 20!r}{tail}")
    return "\n".join(lines) + "\n"


def test_scans_are_placed_and_go_back_with_their_poses(tmp_path: Path) -> None:
    path = tmp_path / "a.ptx"
    path.write_text(scan() + scan(SHIFT + 7))
    cloud = read(path)
    assert len(cloud) == 2 * len(WITH_RETURN), "points without a return are holes"
    np.testing.assert_allclose(cloud.points[: len(WITH_RETURN)], (LOCAL @ TURN + SHIFT)[WITH_RETURN])
    assert cloud.attributes["red"].tolist()[:5] == [0, 1, 2, 4, 5]
    assert cloud.attributes["scan_index"].tolist() == [0] * 19 + [1] * 19
    result = cloud.replaced(cloud.points + 1, np.ones_like(cloud.points), metadata={"seed": "0"})
    notes = write(tmp_path / "b.ptx", result, check=True)
    assert any("normals" in note for note in notes)
    again = (tmp_path / "b.ptx").read_text().splitlines()
    assert again[:10] == scan().splitlines()[:10]
    assert again[13].startswith("0.0 0.0 0.0 ")
    np.testing.assert_allclose(read(tmp_path / "b.ptx").points, cloud.points + 1)


def test_a_scan_without_colours_and_other_formats(tmp_path: Path) -> None:
    (tmp_path / "a.ptx").write_text(scan(colours=False))
    cloud = read(tmp_path / "a.ptx")
    assert list(cloud.attributes) == ["intensity"]
    assert isinstance(cloud.flavour, PtxFlavour)
    write(tmp_path / "a.e57", cloud, format="e57", check=True)
    again = read(tmp_path / "a.e57")
    assert again.holes is not None
    assert again.holes.rows.tolist() == [3]
    eight = {name: np.full(20, 200 * 257, np.uint16) for name in ("red", "green", "blue")}
    write(tmp_path / "b.ptx", PointCloud(points=LOCAL + 1, attributes={**eight, "tag": np.ones(20)}), format="ptx")
    lines = (tmp_path / "b.ptx").read_text().splitlines()
    assert lines[:2] == ["1", "20"]
    assert lines[10].split()[3:] == ["0.5", "200", "200", "200"]


def test_text_that_begins_as_a_ptx_is_one_where_its_name_says_nothing(tmp_path: Path) -> None:
    (tmp_path / "upload").write_text(scan())
    assert isinstance(read(tmp_path / "upload", text=True).flavour, PtxFlavour)


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (("4\n5\n", "4\n500\n"), "truncated"),
        (("4\n5\n", "99999999\n9999999\n"), "too_many_points"),
        (("4\n5\n", "4\nfive\n"), "bad_header"),
        (("0 0 1\n", "0 0 1 0\n"), "bad_header"),
        (("-1.0 0.0 0.0 0", "-3.0 0.0 0.0 0"), "bad_header"),
        (("-1.0 0.0 0.0 0", "-1.0 nan 0.0 0"), "bad_header"),
        ((" 0.0 0 20 30", " 0.0"), "bad_value"),
        ((" 0.05 1 20 30", " 0.05 one 20 30"), "bad_value"),
    ],
)
def test_refusals(tmp_path: Path, change: tuple[str, str], code: str) -> None:
    assert change[0] in scan()
    (tmp_path / "a.ptx").write_text(scan().replace(*change, 1))
    with pytest.raises(FormatError) as caught:
        read(tmp_path / "a.ptx")
    assert caught.value.code == code


@pytest.mark.parametrize(
    ("intensity", "full"),
    [
        (np.array([0, 51, 255], np.uint8), 255),
        (np.array([0, 13107, 4000], np.uint16), 65535),
        (np.array([0, 100000, 500000], np.int64), 500000),
        (np.array([0, 0.2, 1], np.float32), 1),
        (np.array([0, 51, 254.5], np.float32), 255),
        (np.array([np.nan, 0.2, np.inf], np.float64), 1),
    ],
)
def test_intensity_of_other_formats_is_spread_over_0_to_1(tmp_path: Path, intensity: np.ndarray, full: float) -> None:
    notes = write(tmp_path / "a.ptx", PointCloud(points=np.eye(3), attributes={"intensity": intensity}), format="ptx")
    assert any(f"divided by {full:g}" in note for note in notes) == (full != 1)
    np.testing.assert_allclose(read(tmp_path / "a.ptx").attributes["intensity"], intensity / full, rtol=1e-6)
