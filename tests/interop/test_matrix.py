"""Results meet the programs that people go on with; those that are not installed are skipped."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.interop.matrix import GEOREFERENCED, cloud, verdicts
from tests.interop.peers import PEERS

pytestmark = pytest.mark.interop

COARSE = {
    ("Open3D", "pcd"),
    ("Open3D tensor", "pcd"),
    ("Open3D tensor", "pts"),
    ("pypcd4", "pcd"),
    ("PCL", "pcd"),
    ("PCL", "ply"),
}
"""Readers that keep float32 only, with steps of half a metre far from the origin."""

MEETINGS = [pytest.param(peer, ending, id=f"{peer.name}-{ending}") for peer in PEERS for ending in peer.endings]


@pytest.mark.parametrize(("peer", "ending"), MEETINGS)
def test_what_a_reader_finds_is_what_was_written(tmp_path: Path, peer: object, ending: str) -> None:
    if not peer.is_here:  # type: ignore[attr-defined]
        pytest.skip("not installed")
    near = verdicts(peer, ending, cloud(np.zeros(3)), tmp_path)  # type: ignore[arg-type]
    assert near["points"] == "yes", near
    assert set(near.values()) <= {"yes", "-", "yes, 0..1"}, near
    far = verdicts(peer, ending, cloud(GEOREFERENCED), tmp_path)["points"]  # type: ignore[arg-type]
    assert far == ("off by 0.25" if (peer.name, ending) in COARSE else "yes")  # type: ignore[attr-defined]
