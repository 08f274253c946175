"""Where the scanner stood decides the side of normals, in formats that say it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pcdnf.cli import main
from pcdnf.formats import PcdFlavour, PointCloud, PtxFlavour, read, write
from pcdnf.formats.flavours import PtxScan
from pcdnf.formats.scanner_positions import known_sides, scanner_places, towards_scanner
from tests.support.clouds import depth_image

ROWS, COLUMNS = 18, 24
PLACES = np.array([[500_000.0, 5_400_000, 2], [500_030, 5_400_000, 2]])


def room(place: np.ndarray) -> np.ndarray:
    """Walls of a round room, seen from its middle."""
    turn, tilt = np.meshgrid(np.linspace(0, 6, COLUMNS), np.linspace(-0.9, 0.9, ROWS), indexing="ij")
    ways = np.stack([np.cos(turn) * np.cos(tilt), np.sin(turn) * np.cos(tilt), np.sin(tilt)], axis=-1).reshape(-1, 3)
    return place + 5 * ways + np.random.default_rng(0).normal(size=ways.shape) * 0.01


def two_rooms(path: Path, *, is_gridded: bool = True) -> Path:
    size = (COLUMNS, ROWS) if is_gridded else (1, COLUMNS * ROWS)
    scans = []
    for place in PLACES:
        shift = " ".join(map(repr, place.tolist()))
        lines = (shift, "1 0 0", "0 1 0", "0 0 1", "1 0 0 0", "0 1 0 0", "0 0 1 0", f"{shift} 1")
        scans.append(PtxScan(*size, lines))
    index = np.repeat([0, 1], ROWS * COLUMNS).astype(np.uint16)
    points = np.concatenate([room(place) for place in PLACES])
    cloud = PointCloud(points=points, attributes={"scan_index": index}, flavour=PtxFlavour(tuple(scans)))
    write(path, cloud, format="ptx")
    return path


def test_each_point_of_a_ptx_faces_the_scanner_that_saw_it(tmp_path: Path) -> None:
    cloud = read(two_rooms(tmp_path / "a.ptx"))
    expected = PLACES[cloud.attributes["scan_index"]] - cloud.points
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(towards_scanner(cloud), expected, atol=1e-9)


def test_clouds_that_may_come_from_many_places_have_no_scanner(tmp_path: Path) -> None:
    assert towards_scanner(read(two_rooms(tmp_path / "a.ptx", is_gridded=False))) is None
    assert towards_scanner(PointCloud(points=room(PLACES[0]))) is None
    write(tmp_path / "a.e57", PointCloud(points=room(PLACES[0])), format="e57")
    assert towards_scanner(read(tmp_path / "a.e57")) is None


def test_a_gridded_e57_and_an_organised_pcd_have_one(tmp_path: Path) -> None:
    row, column = np.divmod(np.arange(ROWS * COLUMNS), COLUMNS)
    grid = {"rowIndex": row.astype(np.uint16), "columnIndex": column.astype(np.uint16)}
    near = room(np.zeros(3))
    write(tmp_path / "a.e57", PointCloud(points=near, attributes=grid), format="e57")
    flavour = PcdFlavour(width=COLUMNS, height=ROWS, viewpoint="0 0 0 1 0 0 0")
    write(tmp_path / "a.pcd", PointCloud(points=near, flavour=flavour))
    for name in ("a.e57", "a.pcd"):
        found = towards_scanner(read(tmp_path / name))
        assert found is not None, name
        assert ((found * near).sum(axis=1) < -4).all()


def test_normals_of_the_file_come_first() -> None:
    flavour = PcdFlavour(width=COLUMNS, height=ROWS)
    normals = np.ones((ROWS * COLUMNS, 3))
    cloud = PointCloud(points=room(np.zeros(3)), normals=normals, flavour=flavour)
    assert known_sides(cloud) is normals


@pytest.mark.parametrize("more", [[], ["--orient"]])
def test_new_normals_face_the_scanner(tmp_path: Path, more: list[str]) -> None:
    two_rooms(tmp_path / "a.ptx")
    arguments = ["denoise", str(tmp_path / "a.ptx"), "-o", str(tmp_path / "b.ply"), "--iterations", "1", *more]
    assert main([*arguments, "--fast", "--device", "cpu"]) == 0
    result = read(tmp_path / "b.ply")
    inwards = PLACES[result.attributes["scan_index"]] - result.points
    assert ((result.normals * inwards).sum(axis=1) > 0).mean() > 0.99


def test_the_callers_sensor_comes_before_the_files(tmp_path: Path) -> None:
    cloud = read(two_rooms(tmp_path / "a.ptx"))
    places = scanner_places(cloud)
    assert places is not None
    np.testing.assert_array_equal(places, PLACES[cloud.attributes["scan_index"]])
    np.testing.assert_array_equal(scanner_places(cloud, (1, 2, 3)), np.tile([1.0, 2, 3], (len(cloud), 1)))


@pytest.mark.parametrize("how", ["drop", "mark"])
def test_the_viewpoint_of_a_pcd_shows_flying_pixels(tmp_path: Path, how: str) -> None:
    points, kinds = depth_image()
    flavour = PcdFlavour(width=120, height=90, viewpoint="2 0 0 1 0 0 0")
    tag = {"tag": np.arange(len(points), dtype=np.int32)}
    write(tmp_path / "a.pcd", PointCloud(points=points + np.array([2, 0, 0]), attributes=tag, flavour=flavour))
    write(tmp_path / "a.ply", PointCloud(points=points + np.array([2, 0, 0]), attributes=tag))
    expected = np.flatnonzero(kinds["flying"])
    for name, more in (("a.pcd", []), ("a.ply", ["--sensor", "2,0,0"])):
        command = ["denoise", str(tmp_path / name), "-o", str(tmp_path / "b.npz"), "--iterations", "1"]
        assert main([*command, "--outliers", how, *more, "--device", "cpu", "--quiet"]) == 0
        result = read(tmp_path / "b.npz")
        if how == "mark":
            found = np.flatnonzero(result.attributes["outlier"])
        else:
            found = np.setdiff1d(tag["tag"], result.attributes["tag"])
        assert np.isin(expected, found).mean() > 0.9, name


def test_a_sensor_that_is_no_position_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write(tmp_path / "a.ply", PointCloud(points=room(PLACES[0])))
    assert main(["denoise", str(tmp_path / "a.ply"), "-o", str(tmp_path / "b.ply"), "--sensor", "1,2"]) != 0
    assert "three finite numbers with commas between them, such as 1.5,0,2, not '1,2'" in capsys.readouterr().err
