"""COPC: written with an index of its own, or not claimed."""

from __future__ import annotations

import struct
from pathlib import Path

import laspy
import numpy as np
import pytest

from pcdnf.formats import PointCloud, read, write
from pcdnf.formats.las.copc import octree
from pcdnf.formats.las.grid import Grid

COUNT = 30_000


@pytest.fixture(scope="module")
def cloud() -> PointCloud:
    rng = np.random.default_rng(0)
    across = rng.uniform(0, 200, (COUNT, 2))
    return PointCloud(
        points=np.column_stack([across, 5 * np.sin(across[:, 0] / 20)]) + np.array([500_000, 5_400_000, 100]),
        attributes={
            "gps_time": rng.random(COUNT) + 3e8,
            "number": np.arange(COUNT, dtype=np.uint32),
            **{name: rng.integers(0, 256, COUNT).astype(np.uint8) for name in ("red", "green", "blue")},
        },
    )


def test_a_result_named_copc_can_be_queried(tmp_path: Path, cloud: PointCloud) -> None:
    path = tmp_path / "a.copc.laz"
    (note,) = write(path, cloud, format="laz", check=True)
    assert "order" in note
    low, high = np.array([500_000, 5_400_000]), np.array([500_050, 5_400_050])
    inside = ((cloud.points[:, :2] >= low) & (cloud.points[:, :2] <= high)).all(axis=1)
    with laspy.CopcReader.open(path) as reader:
        assert len(reader.query()) == COUNT
        coarse = reader.query(level=0)
        assert 1000 < len(coarse) < COUNT
        part = reader.query(bounds=laspy.copc.Bounds(mins=low, maxs=high))
    np.testing.assert_array_equal(np.sort(part["number"]), np.flatnonzero(inside))


def test_a_copc_read_and_written_again_keeps_its_order(tmp_path: Path, cloud: PointCloud) -> None:
    write(tmp_path / "a.copc.laz", cloud, format="laz")
    first = read(tmp_path / "a.copc.laz")
    assert write(tmp_path / "b.copc.laz", first, check=True) == []
    np.testing.assert_array_equal(read(tmp_path / "b.copc.laz").attributes["number"], first.attributes["number"])
    times = struct.unpack_from("<2d", (tmp_path / "b.copc.laz").read_bytes(), 375 + 54 + 56)
    assert times == (cloud.attributes["gps_time"].min(), cloud.attributes["gps_time"].max())


@pytest.mark.parametrize("name", ["b.laz", "b.las"])
def test_a_copc_under_another_name_does_not_claim_to_be_one(tmp_path: Path, cloud: PointCloud, name: str) -> None:
    write(tmp_path / "a.copc.laz", cloud, format="laz")
    given = read(tmp_path / "a.copc.laz")
    (note,) = write(tmp_path / name, given, format=name[-3:], check=True)
    assert ".copc.laz" in note
    assert b"copc" not in (tmp_path / name).read_bytes()
    assert len(laspy.read(tmp_path / name)) == COUNT


def test_older_point_formats_become_newer_ones(tmp_path: Path) -> None:
    header = laspy.LasHeader(point_format=3, version="1.2")
    header.scales = [0.001] * 3
    las = laspy.LasData(header)
    rng = np.random.default_rng(0)
    las.xyz = rng.normal(size=(500, 3))
    las.scan_angle_rank = np.arange(500) % 30
    las.classification = np.full(500, 2)
    las.red = np.full(500, 40_000)
    las.add_extra_dim(laspy.ExtraBytesParams("temp", np.int16, "in degrees", [-150.0], [0.01]))
    las.add_extra_dim(laspy.ExtraBytesParams("way", "3u1"))
    las["temp"] = np.linspace(-20, 40, 500)
    las["way"] = rng.integers(0, 256, (500, 3))
    las.write(tmp_path / "a.las")
    write(tmp_path / "a.copc.laz", read(tmp_path / "a.las"), format="laz", check=True)
    with laspy.CopcReader.open(tmp_path / "a.copc.laz") as reader:
        points = reader.query()
    assert len(points) == 500
    assert set(points.classification.tolist()) == {2}
    assert set(points.red.tolist()) == {40_000}
    before = read(tmp_path / "a.las")
    order = np.argsort(points["temp"])
    np.testing.assert_allclose(points["temp"][order], las["temp"], atol=1e-9)
    np.testing.assert_array_equal(points["way"][order], before.attributes["way"])
    assert points.point_format.dimension_by_name("temp").description == "in degrees"
    assert int(points.scan_angle.max()) == 4833, "29 degrees in steps of 0.006"


@pytest.mark.parametrize(("point_format", "keys"), [(6, False), (6, True), (3, True)])
def test_the_header_says_that_coordinate_systems_are_wkt(tmp_path: Path, point_format: int, keys: bool) -> None:
    header = laspy.LasHeader(point_format=point_format, version="1.4")
    header.scales = [0.001] * 3
    if keys:  # a directory of GeoTIFF keys without any
        header.vlrs.append(laspy.VLR("LASF_Projection", 34735, "", struct.pack("<4H", 1, 1, 0, 0)))
    las = laspy.LasData(header)
    las.xyz = np.random.default_rng(0).normal(size=(500, 3))
    las.write(tmp_path / "a.las")
    given = read(tmp_path / "a.las")
    assert not struct.unpack_from("<H", (tmp_path / "a.las").read_bytes(), 6)[0] & 0x10
    notes = write(tmp_path / "a.copc.laz", given, format="laz", check=True)
    assert struct.unpack_from("<H", (tmp_path / "a.copc.laz").read_bytes(), 6)[0] & 0x10, "without it copclib refuses"
    assert any("GeoTIFF" in note for note in notes) == keys


def test_nodes_hold_every_point_once_and_their_parents_exist() -> None:
    points = np.random.default_rng(1).uniform(0, 10, (60_000, 3)) ** 3
    tree = octree(points, Grid())
    np.testing.assert_array_equal(np.sort(tree.order), np.arange(len(points)))
    assert tree.counts.sum() == len(points)
    keys = {tuple(key) for key in tree.keys.tolist()}
    assert len(keys) > 8
    assert all((level - 1, x // 2, y // 2, z // 2) in keys for level, x, y, z in keys if level)
    np.testing.assert_array_equal(octree(points[tree.order], Grid()).order, np.arange(len(points)))
