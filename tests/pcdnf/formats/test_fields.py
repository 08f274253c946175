"""Every field of a specification is carried, derived anew, or said to be lost."""

from __future__ import annotations

import struct
from pathlib import Path

import laspy
import numpy as np
import pytest

from pcdnf.formats import read, write
from pcdnf.formats.fields import FIELDS, as_table

ROOT = Path(__file__).parents[3]
POINTS = np.random.default_rng(0).normal(size=(30, 3))

# LAS 1.4 R15, table 3: name in the list, offset, size
LAS_HEADER = [
    ("file source ID", 4, 2),
    ("global encoding", 6, 2),
    ("project ID", 8, 16),
    ("version", 24, 2),
    ("system identifier", 26, 32),
    ("generating software", 58, 32),
    ("creation day and year", 90, 4),
    ("header size", 94, 2),
    ("offset to point data", 96, 4),
    ("number of variable-length records", 100, 4),
    ("point format, record length", 104, 3),
    ("legacy counts", 107, 24),
    ("scale, offset", 131, 48),
    ("bounds", 179, 48),
    ("start of waveforms", 227, 8),
    ("start and number of extended records", 235, 12),
    ("counts", 247, 128),
]


def test_the_list_covers_the_header_of_las_to_the_last_byte() -> None:
    at = 4
    for name, offset, size in LAS_HEADER:
        assert (offset, name in FIELDS["LAS, LAZ"]) == (at, True), name
        at += size
    assert at == 375


@pytest.mark.parametrize(("name", "offset", "size"), [field for field in LAS_HEADER if field[1] < 94])
def test_identifying_fields_of_las_are_carried(tmp_path: Path, name: str, offset: int, size: int) -> None:
    las = laspy.create(point_format=6, file_version="1.4")
    las.xyz = POINTS
    las.write(tmp_path / "a.las")
    data = bytearray((tmp_path / "a.las").read_bytes())
    if name not in ("version", "global encoding"):
        data[offset : offset + size] = bytes(65 + (offset + i) % 26 for i in range(size))
    (tmp_path / "a.las").write_bytes(data)
    cloud = read(tmp_path / "a.las")
    write(tmp_path / "b.las", cloud.replaced(cloud.points, np.ones_like(cloud.points), metadata={"seed": "0"}))
    assert FIELDS["LAS, LAZ"][name] == "carried"
    assert (tmp_path / "b.las").read_bytes()[offset : offset + size] == bytes(data[offset : offset + size])


def test_derived_fields_of_las_follow_the_points(tmp_path: Path) -> None:
    las = laspy.create(point_format=6, file_version="1.4")
    las.xyz = POINTS
    las.return_number = np.ones(30, np.uint8)
    las.write(tmp_path / "a.las")
    cloud = read(tmp_path / "a.las").without(np.array([0]), "Outliers")
    write(tmp_path / "b.las", cloud.replaced(cloud.points + 1, None, metadata={}))
    data = (tmp_path / "b.las").read_bytes()
    assert struct.unpack_from("<2Q", data, 247) == (29, 29)
    high_x, low_x = struct.unpack_from("<2d", data, 179)
    np.testing.assert_allclose([high_x, low_x], [cloud.points[:, 0].max() + 1, cloud.points[:, 0].min() + 1], atol=0.01)


def test_descriptions_of_extra_dimensions_survive(tmp_path: Path) -> None:
    las = laspy.create(point_format=6, file_version="1.4")
    las.add_extra_dim(laspy.ExtraBytesParams("quality", np.uint16, description="of the fit"))
    las.xyz, las.quality = POINTS, np.arange(30)
    las.write(tmp_path / "a.las")
    cloud = read(tmp_path / "a.las")
    write(tmp_path / "b.las", cloud.replaced(cloud.points, np.ones_like(cloud.points), metadata={}))
    dimension = next(
        one for one in laspy.read(tmp_path / "b.las").point_format.extra_dimensions if one.name == "quality"
    )
    assert dimension.description == "of the fit"


def test_the_list_is_in_the_documents() -> None:
    assert as_table() in (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")
