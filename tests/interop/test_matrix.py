"""Results meet the programs that people go on with; those that are not installed are skipped."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pcdnf.formats import PointCloud, write
from tests.interop.matrix import GEOREFERENCED, cloud, reading, verdicts
from tests.interop.peers import PEERS, cloudcompare_columns
from tests.interop.writers import WRITERS

pytestmark = [
    pytest.mark.interop,
    pytest.mark.filterwarnings("ignore:Open3D was built with CUDA:ImportWarning"),
]

COARSE = {
    ("Open3D", "pcd"),
    ("Open3D tensor", "pcd"),
    ("Open3D tensor", "pts"),
    ("pypcd4", "pcd"),
    ("PCL", "pcd"),
    ("three.js", "pcd"),
    ("loaders.gl", "ply"),
    ("loaders.gl", "pcd"),
}
"""Readers that keep float32 only, with steps of half a metre far from the origin."""

FAULTS = {
    ("three.js", "ply"): {"colours": "off by 6"},  # it rounds linear colours to 8 bits
    ("loaders.gl", "pcd"): {"colours": "off by 2.5e+02"},  # it takes blue for red
    ("loaders.gl", "las"): {"points": "fails: CalledProcessError"},  # it reads up to LAS 1.3
    ("loaders.gl", "laz"): {"points": "fails: CalledProcessError"},
}
"""What readers do wrong with files that others read rightly."""

MEETINGS = [pytest.param(peer, ending, id=f"{peer.name}-{ending}") for peer in PEERS for ending in peer.endings]


@pytest.mark.parametrize(("peer", "ending"), MEETINGS)
def test_what_a_reader_finds_is_what_was_written(tmp_path: Path, peer: object, ending: str) -> None:
    if not peer.is_here:  # type: ignore[attr-defined]
        pytest.skip("not installed")
    near = verdicts(peer, ending, cloud(np.zeros(3)), tmp_path)  # type: ignore[arg-type]
    known = FAULTS.get((peer.name, ending), {})  # type: ignore[attr-defined]
    assert {part: near[part] for part in known} == known
    assert {verdict for part, verdict in near.items() if part not in known} <= {"yes", "-", "yes, 0..1"}, near
    if "points" in known:
        return
    far = verdicts(peer, ending, cloud(GEOREFERENCED), tmp_path)["points"]  # type: ignore[arg-type]
    assert far == ("off by 0.25" if (peer.name, ending) in COARSE else "yes")  # type: ignore[attr-defined]


def test_cloudcompare_shows_the_columns_of_diagnostics(tmp_path: Path) -> None:
    (peer,) = {peer.name: peer for peer in PEERS if peer.program == "CloudCompare"}.values()
    if not peer.is_here:
        pytest.skip("not installed")
    values = np.linspace(0, 1, 50)
    added = ("displacement", "estimated_noise", "confidence")
    columns = {name: (values + number).astype(np.float32) for number, name in enumerate(added)}
    points = np.random.default_rng(0).normal(size=(50, 3))
    write(tmp_path / "a.ply", PointCloud(points=points, attributes=columns), check=True)
    names, table = cloudcompare_columns(tmp_path / "a.ply")
    for name, column in columns.items():
        np.testing.assert_allclose(table[:, names.index(name)], column, atol=1e-6)


WRITE_FLOATS = {("Open3D", "pcd"), ("trimesh", "ply"), ("trimesh", "stl"), ("pypcd4", "pcd"), ("pye57", "e57")}
"""Writers that store float32 only."""

FILES = [pytest.param(*pair, ending, id=f"{pair[0].name}-{ending}") for pair in WRITERS for ending in pair[0].endings]


@pytest.mark.parametrize(("peer", "write", "ending"), FILES)
def test_what_another_program_writes_is_what_is_read(tmp_path: Path, peer: object, write: object, ending: str) -> None:
    if not peer.is_here:  # type: ignore[attr-defined]
        pytest.skip("not installed")
    if peer.program:  # type: ignore[attr-defined]
        pytest.importorskip("plyfile", reason="it makes what programs convert")
    near = reading(write, ending, cloud(np.zeros(3)), tmp_path)  # type: ignore[arg-type]
    assert near["points"] == "yes", near
    assert set(near.values()) <= {"yes", "-"}, near
    far = reading(write, ending, cloud(GEOREFERENCED), tmp_path)["points"]  # type: ignore[arg-type]
    assert far == ("off by 0.25" if (peer.name, ending) in WRITE_FLOATS else "yes")  # type: ignore[attr-defined]
