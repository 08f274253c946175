"""Degrees with heights in metres are refused, and nothing else is."""

from __future__ import annotations

import struct
from pathlib import Path

import laspy
import numpy as np
import pytest

from pcdnf.cli import main
from pcdnf.denoiser import CloudError
from pcdnf.formats import E57Flavour, FormatError, LasFlavour, PointCloud, read, write
from pcdnf.formats.geographic import check_metric, looks_geographic
from pcdnf.formats.las.header import Record
from pcdnf.formats.limits import Limits
from pcdnf.formats.sandbox.check import describe
from pcdnf.inference.unit_frame import checked_points

RNG = np.random.default_rng(0)
SITE = RNG.uniform(0, [300, 200, 25], (400, 3))
DEGREES = SITE / [71_000, 111_000, 1] + [11.57, 48.14, 520]
UTM_PLACE = np.array([691_000, 5_335_000, 520])
WGS84 = 'GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563]],UNIT["degree",0.0174532925199433]]'
UTM = f'PROJCS["WGS 84 / UTM zone 32N",{WGS84},PROJECTION["Transverse_Mercator"],UNIT["metre",1]]'
WGS84_2 = 'GEOGCRS["WGS 84",DATUM["World Geodetic System 1984",ELLIPSOID["WGS 84",6378137,298.25]],CS[ellipsoidal,3]]'


def las(points: np.ndarray, number: int, data: bytes) -> PointCloud:
    return PointCloud(points=points, flavour=LasFlavour(records=(Record(b"LASF_Projection", number, b"", data),)))


def geo_keys(model: int) -> bytes:
    return struct.pack("<12H", 1, 1, 0, 2, 1024, 0, 1, model, 2048, 0, 1, 4326)


@pytest.mark.parametrize(
    "cloud",
    [
        las(DEGREES, 2112, WGS84.encode() + b"\0"),
        las(DEGREES, 2112, WGS84_2.encode()),
        las(DEGREES * [1, 1, 0], 34735, geo_keys(2)),
        PointCloud(points=DEGREES, flavour=E57Flavour(coordinate_system=WGS84)),
        PointCloud(points=DEGREES),
        PointCloud(points=DEGREES[:, [1, 0, 2]]),
    ],
)
def test_degrees_are_refused_and_the_way_out_is_named(cloud: PointCloud) -> None:
    with pytest.raises(FormatError, match="degrees") as caught:
        check_metric(cloud)
    assert caught.value.code == "geographic_coordinates"
    assert "Reproject the cloud to a coordinate system in metres" in str(caught.value.hint)


@pytest.mark.parametrize(
    "cloud",
    [
        las(SITE + UTM_PLACE, 2112, UTM.encode()),
        las(SITE + UTM_PLACE, 2112, WGS84.encode()),
        las(SITE, 34735, geo_keys(1)),
        PointCloud(points=SITE / 60, flavour=E57Flavour(coordinate_system=WGS84)),
        PointCloud(points=SITE / 60),
        PointCloud(points=SITE * [0.0004, 0.0005, 0.4] + [50, 30, 0]),
        PointCloud(points=DEGREES - DEGREES.mean(0)),
    ],
)
def test_metres_are_not_refused(cloud: PointCloud) -> None:
    check_metric(cloud)


def test_rows_far_away_or_not_finite_hide_nothing() -> None:
    some = DEGREES.copy()
    some[:3] = [[np.nan] * 3, [0, 0, 0], [1e6, 1e6, 0]]
    assert looks_geographic(some)


def test_every_way_in_refuses_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write(tmp_path / "a.ply", PointCloud(points=DEGREES))
    assert main(["denoise", str(tmp_path / "a.ply"), "-o", str(tmp_path / "b.ply")]) != 0
    assert "Reproject the cloud" in capsys.readouterr().err
    with pytest.raises(CloudError, match="degrees"):
        checked_points(DEGREES, 16)
    with pytest.raises(FormatError, match="degrees"):
        describe(str(tmp_path / "a.ply"), Limits(), text=False)


@pytest.mark.parametrize("system", ["wkt", "geotiff"])
def test_a_las_of_another_program_is_refused(tmp_path: Path, system: str) -> None:
    header = laspy.LasHeader(point_format=6 if system == "wkt" else 3, version="1.4" if system == "wkt" else "1.2")
    header.scales, header.offsets = np.array([1e-7, 1e-7, 1e-3]), DEGREES.min(0)
    if system == "wkt":
        header.vlrs.append(laspy.VLR("LASF_Projection", 2112, "", WGS84.encode() + b"\0"))
    else:
        header.vlrs.append(laspy.VLR("LASF_Projection", 34735, "", geo_keys(2)))
    file = laspy.LasData(header)
    file.x, file.y, file.z = DEGREES.T * [[1], [1], [0]]
    file.write(tmp_path / "a.las")
    with pytest.raises(FormatError, match="coordinate system is geographic"):
        check_metric(read(tmp_path / "a.las"))
