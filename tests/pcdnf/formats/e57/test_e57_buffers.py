"""E57: what is written is what another reader finds, at every size, type and pose."""

from __future__ import annotations

import gc
from pathlib import Path
from typing import Any

import numpy as np
import pye57
import pytest
from scipy.spatial.transform import Rotation

from pcdnf.formats import PointCloud, read, write
from pcdnf.formats.e57.buffers import Buffers

TURN = np.array([0.5, 0.5, -0.5, 0.5])  # as (w, x, y, z)
SHIFT = np.array([4_480_000.25, -500_000.5, 12.125])


def raw(path: Path, scan: int = 0) -> dict[str, np.ndarray[Any, Any]]:
    """The cartesian coordinates and colours of a scan as pye57 reads them."""
    with pye57.E57(str(path)) as file:
        return dict(file.read_scan_raw(scan, ignore_unsupported_fields=True))


@pytest.mark.parametrize("count", [153, 20_000, 400_000])
def test_every_point_arrives_at_every_size(tmp_path: Path, count: int) -> None:
    rng = np.random.default_rng(count)
    points = rng.uniform(1, 2, (count, 3))
    normals = rng.normal(size=(count, 3)).astype(np.float32)
    red = rng.integers(0, 256, count).astype(np.uint8)
    cloud = PointCloud(points=points, normals=normals, attributes={"red": red, "intensity": points[:, 0]})
    write(tmp_path / "a.e57", cloud, format="e57")
    found = raw(tmp_path / "a.e57")
    np.testing.assert_array_equal(np.c_[found["cartesianX"], found["cartesianY"], found["cartesianZ"]], points)
    np.testing.assert_array_equal(found["colorRed"], red)
    again = read(tmp_path / "a.e57")
    np.testing.assert_array_equal(again.points, points)
    np.testing.assert_array_equal(again.normals, normals)
    np.testing.assert_array_equal(again.attributes["intensity"], points[:, 0])


@pytest.mark.parametrize("kind", ["i1", "u1", "i2", "u2", "i4", "u4", "i8", "f4", "f8"])
def test_columns_of_every_type_keep_their_values_and_type(tmp_path: Path, kind: str) -> None:
    count = 5_000
    type_ = np.dtype(kind)
    bounds = np.iinfo(type_) if type_.kind in "iu" else np.finfo(type_)
    values = np.linspace(float(bounds.min) / 2, float(bounds.max) / 2, count).astype(type_)
    values[:2] = bounds.min, bounds.max
    cloud = PointCloud(points=np.random.default_rng(0).normal(size=(count, 3)), attributes={"intensity": values})
    write(tmp_path / "a.e57", cloud, format="e57")
    again = read(tmp_path / "a.e57").attributes["intensity"]
    np.testing.assert_array_equal(again, values)
    assert again.dtype == type_


def write_raw(path: Path, fields: dict[str, np.ndarray[Any, Any]]) -> None:
    """A file of one scan; floats are doubles, integers have no bounds. pye57 itself writes neither."""
    with pye57.E57(str(path), mode="w") as file:
        image = file.image_file
        prototype = pye57.libe57.StructureNode(image)
        buffers = Buffers(image, len(fields[next(iter(fields))]))
        for name, values in fields.items():
            is_float = values.dtype.kind == "f"
            node = pye57.libe57.FloatNode(image, 0.0) if is_float else pye57.libe57.IntegerNode(image, 0)
            prototype.set(name, node)
            buffers.add(name, values)
        points = pye57.libe57.CompressedVectorNode(image, prototype, pye57.libe57.VectorNode(image, True))
        scan = pye57.libe57.StructureNode(image)
        scan.set("guid", pye57.libe57.StringNode(image, "a"))
        scan.set("points", points)
        file.data3d.append(scan)
        writer = points.writer(buffers.vector)
        writer.write(len(values))
        writer.close()


def test_integers_without_bounds_are_read_as_they_are(tmp_path: Path) -> None:
    values = np.arange(-30, 30) * 10**12
    axes = {f"cartesian{axis}": np.linspace(0, 1, len(values)) for axis in "XYZ"}
    write_raw(tmp_path / "a.e57", axes | {"rowIndex": values})
    np.testing.assert_array_equal(read(tmp_path / "a.e57").attributes["rowIndex"], values)


def test_several_large_scans_with_turned_poses(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    local = [rng.normal(size=(count, 3)) for count in (20_000, 153, 9_999)]
    with pye57.E57(str(tmp_path / "a.e57"), mode="w") as file:
        for number, points in enumerate(local):
            data = {f"cartesian{axis}": points[:, index].copy() for index, axis in enumerate("XYZ")}
            file.write_scan_raw(data, rotation=TURN, translation=SHIFT * number)
    cloud = read(tmp_path / "a.e57")
    turn = Rotation.from_quat(TURN, scalar_first=True)
    expected = [turn.apply(points) + SHIFT * number for number, points in enumerate(local)]
    np.testing.assert_allclose(cloud.points, np.concatenate(expected), atol=1e-8)
    normals = rng.normal(size=cloud.points.shape).astype(np.float32)
    write(tmp_path / "b.e57", cloud.replaced(cloud.points, normals), format="e57")
    for number, points in enumerate(local):
        found = raw(tmp_path / "b.e57", number)
        np.testing.assert_allclose(
            np.c_[found["cartesianX"], found["cartesianY"], found["cartesianZ"]], points, atol=2e-9
        )
    again = read(tmp_path / "b.e57")
    np.testing.assert_allclose(again.normals, normals, atol=1e-6)
    np.testing.assert_array_equal(again.attributes["scan_index"], cloud.attributes["scan_index"])


def test_a_large_spherical_scan(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    count = 20_000
    reach, azimuth = rng.uniform(1, 50, count), rng.uniform(-3, 3, count)
    elevation = rng.uniform(-1.5, 1.5, count)
    names = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
    write_raw(tmp_path / "a.e57", dict(zip(names, (reach, azimuth, elevation), strict=True)))
    flat = reach * np.cos(elevation)
    expected = np.c_[flat * np.cos(azimuth), flat * np.sin(azimuth), reach * np.sin(elevation)]
    cloud = read(tmp_path / "a.e57")
    np.testing.assert_allclose(cloud.points, expected, atol=1e-8)
    write(tmp_path / "b.e57", cloud, format="e57")
    found = raw(tmp_path / "b.e57")
    np.testing.assert_allclose(
        np.c_[found["cartesianX"], found["cartesianY"], found["cartesianZ"]], expected, atol=1e-8
    )


def test_buffers_keep_their_arrays(tmp_path: Path) -> None:
    image = pye57.libe57.ImageFile(str(tmp_path / "a.e57"), "w")
    buffers = Buffers(image, 1000)
    kept = [buffers.add(f"field{number}", np.full(1000, number, "i4")) for number in range(8)]
    addresses = [array.__array_interface__["data"][0] for array in kept]
    del kept
    gc.collect()
    others = [np.zeros(1000, np.int64) for _ in range(8)]
    assert not {array.__array_interface__["data"][0] for array in others} & set(addresses)
    with pytest.raises(ValueError, match="shape"):
        buffers.add("short", np.zeros(3))
    image.close()
