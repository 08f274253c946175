"""What is written is read back before it takes the place of a file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pytest

from pcdnf.file_formats import TEXT_FORMATS
from pcdnf.formats import FormatError, PointCloud, read, write
from pcdnf.formats.codec import FileCodec
from pcdnf.formats.ply.codec import read_ply, write_ply
from pcdnf.formats.registry import CODECS

RNG = np.random.default_rng(0)
CLOUD = PointCloud(
    points=RNG.normal(size=(50, 3)) + 1000,
    normals=RNG.normal(size=(50, 3)),
    attributes={"intensity": np.arange(50, dtype=np.uint16)},
)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("scale", [1e-3, 1, 100])
@pytest.mark.parametrize("ending", list(CODECS))
def test_every_format_passes_the_check(tmp_path: Path, ending: str, scale: float, dtype: type[np.floating]) -> None:
    cloud = replace(CLOUD, points=(CLOUD.points * scale).astype(dtype), normals=CLOUD.normals.astype(dtype))
    write(tmp_path / "a", cloud, format=ending, check=True)
    found = read(tmp_path / "a", text=ending in TEXT_FORMATS)
    np.testing.assert_allclose(found.points, cloud.points, rtol=2e-7)


def _spoil(change: Callable[[PointCloud], PointCloud]) -> Callable[[BinaryIO, PointCloud], list[str]]:
    return lambda file, cloud: write_ply(file, change(cloud))


def _moved(cloud: PointCloud) -> PointCloud:
    points = cloud.points.copy()
    points[0, 1] += 0.01
    return cloud.replaced(points, None)


def _other_column(cloud: PointCloud) -> PointCloud:
    return PointCloud(
        points=cloud.points, normals=cloud.normals, attributes={"intensity": np.zeros(len(cloud), np.uint16)}
    )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda cloud: cloud.only(np.arange(49)), "49 points in place of 50"),
        (_moved, "coordinates are other ones"),
        (lambda cloud: cloud.replaced(cloud.points, -cloud.normals), "normals"),
        (_other_column, "'intensity'"),
    ],
)
def test_a_wrong_file_is_an_error_and_not_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, change: Any, words: str
) -> None:
    monkeypatch.setitem(CODECS, "ply", FileCodec("ply", read_ply, _spoil(change)))
    with pytest.raises(FormatError, match=words) as caught:
        write(tmp_path / "a.ply", CLOUD, check=True)
    assert caught.value.code == "written_wrong"
    assert list(tmp_path.iterdir()) == []
