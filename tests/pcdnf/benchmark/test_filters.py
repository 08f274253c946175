"""Filters with a parameter, where they are installed, and what is said where they are not."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from pcdnf.benchmark.choice import Choice
from pcdnf.benchmark.clouds import analytic_clouds
from pcdnf.benchmark.filters import Plane
from pcdnf.benchmark.programs import PROGRAMS, CloudCompare, MeshLab, PclMls, missing_programs
from pcdnf.benchmark.scan_peers import scan_peers, with_programs
from pcdnf.errors import PcdnfError
from pcdnf.metrics import score

CLOUD = analytic_clouds(3000)[2]
NOISY = CLOUD.noisy(1.0)
AWAY = np.array([4.0e5, 5.0e6, 100.0])
"""As in a map's coordinates, where float32 has no millimetres left."""


def needs(name: str) -> pytest.MarkDecorator:
    lacking = [program for program in PROGRAMS[name] if shutil.which(program) is None]
    return pytest.mark.skipif(bool(lacking), reason=f"{lacking} not on the path")


def distance(points: np.ndarray) -> float:
    return score(points - AWAY, None, CLOUD.points, CLOUD.normals).point_to_surface


def test_planes_bring_points_nearer_and_keep_their_order() -> None:
    output = Plane(32).run(NOISY + AWAY, 0.0)
    assert distance(output.points) < 0.7 * distance(NOISY + AWAY)
    assert np.median(np.linalg.norm(output.points - NOISY - AWAY, axis=1)) < 0.05


@needs("pcl-mls")
def test_pcl_brings_points_nearer_to_the_surface() -> None:
    output = PclMls(8.0).run(NOISY + AWAY, 0.0)
    assert len(output.points) <= len(NOISY)
    assert distance(output.points) < 0.6 * distance(NOISY + AWAY)
    assert np.allclose(np.linalg.norm(output.normals, axis=1), 1, atol=1e-3)


@needs("rimls")
@pytest.mark.parametrize("surface", ["RIMLS", "APSS"])
def test_meshlab_brings_points_nearer_and_keeps_their_order(surface: str) -> None:
    output = MeshLab(surface, 6.0).run(NOISY + AWAY, 0.0)
    assert distance(output.points) < 0.7 * distance(NOISY + AWAY)
    assert np.median(np.linalg.norm(output.points - NOISY - AWAY, axis=1)) < 0.05


@needs("cloudcompare")
def test_cloudcompare_drops_points_and_moves_none() -> None:
    strewn = np.concatenate([NOISY, np.random.default_rng(1).uniform(-2, 2, (60, 3))])
    output = CloudCompare(1.0).run(strewn + AWAY, 0.0)
    assert output.facts["dropped"] == len(strewn) - len(output.points) > 30
    assert np.isin(output.points, strewn + AWAY).all()


def test_a_program_that_is_missing_is_told_in_a_sentence(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    said = missing_programs(["jet", "pcl-mls", "rimls"])
    assert list(said) == ["pcl-mls", "rimls"]
    assert said["pcl-mls"] == ("pcl-mls is left out: pcl_mls_smoothing is not on the path (apt-get install pcl-tools).")
    assert "apt-get install meshlab xvfb" in said["rimls"]


def test_a_program_that_fails_is_a_failed_peer(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "pcl_mls_smoothing").write_text("#!/bin/sh\nexit 3\n")
    (tmp_path / "pcl_mls_smoothing").chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    with pytest.raises(PcdnfError, match="pcl_mls_smoothing ended with status 3") as caught:
        PclMls(5.0).run(NOISY, 0.0)
    assert caught.value.code == "peer_failed"


def test_peers_by_name() -> None:
    (plane,) = scan_peers(["plane"])
    assert isinstance(plane, Choice)
    assert [one.name for one in plane.candidates] == ["k = 16", "k = 32", "k = 64", "k = 128", "k = 256"]
    assert [row.name for row in with_programs(["apss"])] == ["MeshLab APSS, best scale"]
    with pytest.raises(PcdnfError, match="no peer for scans named 'wlop'"):
        scan_peers(["wlop"])
    with pytest.raises(PcdnfError, match="no peer named 'plane'"):
        with_programs(["plane"])
