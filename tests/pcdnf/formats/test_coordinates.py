"""Types of coordinates, and float32 whose steps are too coarse."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pcdnf.formats import FormatError, Limits, NpzFlavour, PcdFlavour, PlyFlavour, PointCloud, read, write
from pcdnf.formats.attributes import without_classes

NEAR = np.random.default_rng(0).normal(size=(400, 3))
OFFSET = np.array([500_000, 5_400_000, 0])


@pytest.mark.parametrize("flavour", [PlyFlavour(), NpzFlavour(), PcdFlavour()])
def test_coarse_steps_are_warned_of_and_kept_out_of_results(
    tmp_path: Path, flavour: PlyFlavour | NpzFlavour | PcdFlavour
) -> None:
    write(tmp_path / "a", PointCloud(points=(NEAR + OFFSET).astype(np.float32), flavour=flavour))
    cloud = read(tmp_path / "a")
    assert "steps of 0.5" in cloud.warnings[-1]
    result = cloud.replaced(NEAR + OFFSET, None)
    write(tmp_path / "b", result, check=True)
    np.testing.assert_allclose(read(tmp_path / "b").points, NEAR + OFFSET, atol=2e-8, rtol=0)
    write(tmp_path / "near", PointCloud(points=NEAR.astype(np.float32), flavour=flavour))
    assert read(tmp_path / "near").points.dtype == np.float32


@pytest.mark.parametrize("ending", ["ply", "pcd", "npz"])
def test_float32_moves_far_clouds_and_writes_the_offset_down(tmp_path: Path, ending: str) -> None:
    cloud = PointCloud(points=NEAR + OFFSET, metadata={"seed": "0"})
    (note,) = write(tmp_path / "a", cloud, format=ending, coordinates="float32", check=True)
    assert "add 500000 5400000 0" in note
    again = read(tmp_path / "a")
    assert again.points.dtype == np.float32
    assert again.metadata == {"seed": "0", "offset": "500000 5400000 0"}
    np.testing.assert_allclose(again.points, NEAR, atol=1e-6)
    assert cloud.metadata == {"seed": "0"}
    assert write(tmp_path / "a", PointCloud(points=NEAR), format=ending, coordinates="float32") == []


def test_float64_gives_a_pcd_with_doubles(tmp_path: Path) -> None:
    cloud = PointCloud(points=NEAR + OFFSET, attributes={"scalar_Intensity": np.arange(400)})
    assert write(tmp_path / "a", cloud, format="pcd", coordinates="float64") == []
    np.testing.assert_array_equal(read(tmp_path / "a").points, NEAR + OFFSET)


def test_points_put_aside_come_back_as_they_are(tmp_path: Path) -> None:
    classes = np.array([2, 7, 2, 18, 2, 2], np.uint8)
    points = NEAR[:6].copy()
    points[4] = np.nan
    cloud = PointCloud(points=points, normals=np.ones((6, 3)), attributes={"classification": classes})
    write(tmp_path / "a.ply", cloud)
    given = read(tmp_path / "a.ply")
    rest = without_classes(given, (7, 18))
    assert len(rest) == 3
    assert "2 points of the classes 7, 18 were left as they are." in rest.warnings
    assert without_classes(given, ()) is given
    with pytest.raises(FormatError, match="3 points; at least 4"):
        without_classes(given, (7, 18), Limits(minimum_points=4))
    whole = rest.replaced(rest.points + 1, -np.ones((3, 3))).whole()
    np.testing.assert_array_equal(whole.points[[1, 3]], points[[1, 3]])
    np.testing.assert_array_equal(whole.points[[0, 2, 5]], points[[0, 2, 5]] + 1)
    assert np.isnan(whole.points[4]).all()
    write(tmp_path / "b.las", rest, format="las", check=True)
    assert read(tmp_path / "b.las").attributes["classification"].tolist() == [2, 7, 2, 18, 2]
