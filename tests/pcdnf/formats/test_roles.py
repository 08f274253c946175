"""Names of normals and colours as programs write them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pcdnf.formats import PlyFlavour, PointCloud, read, write
from pcdnf.formats.roles import canonical_name, column_name, find_colours, find_normals, free_normals, ply_name

SPELLINGS = [
    ("nx", "ny", "nz"),
    ("Nx", "Ny", "Nz"),
    ("normal_x", "normal_y", "normal_z"),
    ("normalx", "normaly", "normalz"),
    ("NormalX", "NormalY", "NormalZ"),
]
POINTS = np.random.default_rng(0).normal(size=(30, 3))
NORMALS = np.tile([0.6, 0, 0.8], (30, 1))


@pytest.mark.parametrize("names", SPELLINGS)
@pytest.mark.parametrize("ending", ["ply", "pcd", "las", "csv"])
def test_normals_are_found_under_every_name_and_go_back_under_it(
    tmp_path: Path, names: tuple[str, str, str], ending: str
) -> None:
    columns = dict(zip(names, NORMALS.T, strict=True))
    write(tmp_path / "a", PointCloud(points=POINTS, attributes=columns), format=ending)
    cloud = read(tmp_path / "a", text=True)
    assert cloud.normals is not None
    write(tmp_path / "b", cloud.replaced(cloud.points, -NORMALS, metadata={}))
    again = read(tmp_path / "b", text=True)
    np.testing.assert_allclose(again.normals, -NORMALS, atol=1e-6)  # type: ignore[arg-type]
    assert again.flavour.normals == names  # type: ignore[union-attr]
    assert find_normals(again.attributes) is None, "one set of normals"


def test_stale_normals_never_stay_beside_new_ones(tmp_path: Path) -> None:
    both = {
        **dict(zip(SPELLINGS[0], NORMALS.T, strict=True)),
        **dict(zip(SPELLINGS[4], NORMALS.T, strict=True)),
        "tag": np.arange(30, dtype=np.int32),
    }
    write(tmp_path / "a.ply", PointCloud(points=POINTS, attributes=both, flavour=PlyFlavour()))
    cloud = read(tmp_path / "a.ply")
    assert "NormalX" in cloud.attributes
    result = cloud.replaced(cloud.points, -NORMALS)
    assert list(result.attributes) == ["tag"]
    assert "NormalX, NormalY, NormalZ" in result.warnings[-1]
    assert cloud.replaced(cloud.points, None).attributes.keys() == cloud.attributes.keys()


def test_names_of_colours_and_other_known_columns() -> None:
    assert find_colours(["x", "diffuse_red", "Diffuse_Green", "diffuse_blue"]) == (
        "diffuse_red",
        "Diffuse_Green",
        "diffuse_blue",
    )
    assert find_colours(["scalar_R", "scalar_G", "scalar_B"]) == ("scalar_R", "scalar_G", "scalar_B")
    assert find_colours(["Rf", "Gf", "Bf"]) == ("Rf", "Gf", "Bf"), "as CloudCompare names floats"
    assert find_colours(["red", "green"]) is None
    assert canonical_name("scalar_GpsTime") == "gps_time"
    assert canonical_name("Intensity") == "intensity"
    assert canonical_name("confidence") == canonical_name("scalar_Confidence") == "confidence"


def test_names_that_only_cloudcompare_looks_for() -> None:
    assert [ply_name(name) for name in ("confidence", "pcdnf_displacement", "intensity", "label")] == [
        "scalar_confidence",
        "scalar_pcdnf_displacement",
        "intensity",
        "label",
    ]
    assert column_name("scalar_confidence", ()) == "confidence"
    assert column_name("scalar_confidence", ("confidence",)) == "scalar_confidence"
    assert column_name("scalar_Intensity", ()) == "scalar_Intensity"
    assert column_name("confidence", ()) == "confidence"


def test_new_normals_take_names_that_are_free() -> None:
    assert free_normals(["x"]) == ("nx", "ny", "nz")
    assert free_normals(["NX"]) == ("normal_x", "normal_y", "normal_z")
    assert free_normals(["nx", "normal_y"]) == ("denoised_nx", "denoised_ny", "denoised_nz")
    assert free_normals(["nx", "normal_y", "denoised_nz"]) == ("denoised_nx_2", "denoised_ny_2", "denoised_nz_2")
