"""Types and bounds of the standard, both ways: our reader and writer, libE57 and a reader of the tests agree."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pye57 import libe57

from pcdnf.formats import PointCloud, read, write
from tests.support.e57_reader import scans

COUNT = 700
POINTS = np.random.default_rng(0).normal(size=(COUNT, 3))
LEAST, MOST = -(2**63), 2**63 - 1
BOUNDS = [
    (0, 1), (-5, 5), (0, 255), (0, 4095), (0, 65535), (-32768, 32767), (0, 2**17), (-(2**31), 2**31 - 1),
    (0, 2**32 - 1), (2**40, 2**40 + 3), (-(2**40), 2**40), (7, 7), (0, MOST), (LEAST, MOST),
]  # fmt: skip


def between(least: int, most: int) -> np.ndarray:
    """Whole numbers from both ends of a range and from all of it, as int64."""
    rng = np.random.default_rng(1)
    values = rng.integers(least, most, COUNT, np.int64, endpoint=True)
    values[:2] = least, most
    return values


def foreign(path: Path, field: object, values: np.ndarray) -> None:
    """A file of libE57 with one column beside the coordinates; its arrays live until it is closed."""
    image = libe57.ImageFile(str(path), "w")
    image.extensionsAdd("", libe57.E57_V1_0_URI)
    data = libe57.VectorNode(image, True)
    image.root().set("data3D", data)
    scan, prototype = libe57.StructureNode(image), libe57.StructureNode(image)
    data.append(scan)
    scan.set("guid", libe57.StringNode(image, "{scan}"))
    arrays = {f"cartesian{axis}": np.ascontiguousarray(POINTS[:, i]) for i, axis in enumerate("XYZ")}
    for name in arrays:
        prototype.set(name, libe57.FloatNode(image, 0.0))
    arrays["intensity"] = values
    prototype.set("intensity", field(image))  # type: ignore[operator]
    points = libe57.CompressedVectorNode(image, prototype, libe57.VectorNode(image, True))
    scan.set("points", points)
    buffers = libe57.VectorSourceDestBuffer()
    for name, array in arrays.items():
        buffers.append(libe57.SourceDestBuffer(image, name, array, COUNT, True, True))
    writer = points.writer(buffers)
    writer.write(COUNT)
    writer.close()
    image.close()


@pytest.mark.parametrize(("least", "most"), BOUNDS)
def test_integers_of_all_bounds_are_read_and_written_as_they_are(tmp_path: Path, least: int, most: int) -> None:
    values = between(least, most)
    bounds = () if (least, most) == (LEAST, MOST) else (least, most)  # the standard's default has none
    first = tmp_path / "a.e57"
    foreign(first, lambda image: libe57.IntegerNode(image, least, *bounds), values.astype(np.longlong))
    assert scans(first)[0]["intensity"].tolist() == values.tolist()
    cloud = read(first)
    assert cloud.attributes["intensity"].dtype.kind in "iu"
    assert cloud.attributes["intensity"].tolist() == values.tolist()
    write(tmp_path / "b.e57", cloud, check=True)
    (found,) = scans(tmp_path / "b.e57")
    assert found["intensity"].tolist() == values.tolist()
    np.testing.assert_array_equal(found["cartesianX"], cloud.points[:, 0])


@pytest.mark.parametrize("kind", ["i1", "u1", "i2", "u2", "i4", "u4", "i8", "f4", "f8"])
def test_columns_of_all_types_are_what_a_second_reader_finds(tmp_path: Path, kind: str) -> None:
    if kind[0] == "f":
        values = np.random.default_rng(2).normal(size=COUNT).astype(kind)
    else:
        values = between(int(np.iinfo(kind).min), int(np.iinfo(kind).max)).astype(kind)
    write(tmp_path / "a.e57", PointCloud(points=POINTS, attributes={"intensity": values}), format="e57", check=True)
    (found,) = scans(tmp_path / "a.e57")
    assert found["intensity"].tolist() == values.tolist()
    np.testing.assert_array_equal(np.stack([found[f"cartesian{axis}"] for axis in "XYZ"], axis=1), POINTS)


@pytest.mark.parametrize("bounds", [(0, 4095), (-(2**31), 2**31 - 1), ()])
def test_scaled_integers_are_read_as_both_read_them(tmp_path: Path, bounds: tuple[int, ...]) -> None:
    stored = between(*(bounds or (-(2**50), 2**50)))
    values = stored * 0.001 + 5
    foreign(
        tmp_path / "a.e57",
        lambda image: libe57.ScaledIntegerNode(image, int(stored[0]), *(bounds or (LEAST, MOST)), 0.001, 5.0),
        values,
    )
    found = scans(tmp_path / "a.e57")[0]["intensity"]
    np.testing.assert_allclose(found.astype(float), values, rtol=1e-12, atol=0.0011)
    np.testing.assert_array_equal(read(tmp_path / "a.e57").attributes["intensity"], found.astype(float))
