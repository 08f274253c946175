"""Types of coordinates, and float32 whose steps are too coarse."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pcdnf.cli import main
from pcdnf.formats import NpzFlavour, PcdFlavour, PlyFlavour, PointCloud, read, write
from pcdnf.formats.coordinates import without_steps

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


def test_steps_above_the_noise_are_kept_out_of_the_result(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    x, y = np.random.default_rng(1).uniform(0, 40, (2, 1200))
    sheet = np.column_stack([x, y, 0.2 * np.sin(x / 8)])
    sheet[:, 2] += np.random.default_rng(2).normal(0, 0.003, len(sheet))
    write(tmp_path / "a.ply", PointCloud(points=(sheet + np.array([500_000, 0, 0])).astype(np.float32)))
    given = read(tmp_path / "a.ply")
    assert given.points.dtype == np.float32
    assert without_steps(given, 0.1) is given
    assert without_steps(PointCloud(points=sheet.astype(np.float32)), 0.0).points.dtype == np.float32
    command = ["denoise", str(tmp_path / "a.ply"), "-o", str(tmp_path / "b.ply"), "--iterations", "1"]
    assert main([*command, "--device", "cpu", "--quiet"]) == 0
    assert "steps of 0.031" in capsys.readouterr().err
    assert read(tmp_path / "b.ply").points.dtype == np.float64


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


@pytest.mark.parametrize("ending", ["las", "laz", "e57", "csv", "pts", "ptx"])
def test_nothing_is_moved_where_the_offset_has_no_place(tmp_path: Path, ending: str) -> None:
    cloud = PointCloud(points=NEAR + OFFSET)
    notes = write(tmp_path / "a", cloud, format=ending, coordinates="float32", check=True)
    assert any("were not moved for float32" in note for note in notes)
    np.testing.assert_allclose(read(tmp_path / "a", text=True).points, cloud.points, atol=2e-3)


def test_float64_gives_doubles_to_a_pcd_of_floats(tmp_path: Path) -> None:
    points = np.random.default_rng(0).normal(size=(80, 3)).astype(np.float32)
    write(tmp_path / "a.pcd", PointCloud(points=points), format="pcd")
    given = read(tmp_path / "a.pcd")
    assert given.points.dtype == np.float32
    write(tmp_path / "b.pcd", given, format="pcd", coordinates="float64")
    assert b"FIELDS x y z\nSIZE 8 8 8\n" in (tmp_path / "b.pcd").read_bytes()


def test_float64_gives_a_pcd_with_doubles(tmp_path: Path) -> None:
    cloud = PointCloud(points=NEAR + OFFSET, attributes={"scalar_Intensity": np.arange(400)})
    assert write(tmp_path / "a", cloud, format="pcd", coordinates="float64") == []
    np.testing.assert_array_equal(read(tmp_path / "a").points, NEAR + OFFSET)
