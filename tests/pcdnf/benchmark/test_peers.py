"""Peers: each where its library is installed, and what is said where it is not."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
import pytest

from pcdnf.benchmark import peers
from pcdnf.benchmark.clouds import analytic_clouds
from pcdnf.benchmark.peers import NEIGHBOURS, peer_methods
from pcdnf.errors import PcdnfError
from pcdnf.metrics import score


@pytest.mark.parametrize(("name", "share"), [("jet", 0.6), ("bilateral", 0.95)])
@pytest.mark.filterwarnings("ignore:builtin type:DeprecationWarning")  # SWIG's
def test_cgal_brings_points_nearer_to_the_surface(name: str, share: float) -> None:
    pytest.importorskip("CGAL")
    cloud = analytic_clouds(3000)[2]
    noisy = cloud.noisy(1.0)
    (method,) = peer_methods([name])
    output = method.run(noisy, 0.5)
    before, after = (score(points, None, cloud.points, cloud.normals) for points in (noisy, output.points))
    assert after.point_to_surface < share * before.point_to_surface
    assert np.median(np.linalg.norm(output.points - noisy, axis=1)) < 0.1  # the order is kept
    assert output.facts == {"neighbours": 60}
    assert np.array_equal(output.points, method.run(noisy, 0.5).points)


@pytest.mark.filterwarnings("ignore:builtin type:DeprecationWarning")
def test_wlop_resamples() -> None:
    pytest.importorskip("CGAL")
    (method,) = peer_methods(["wlop"])
    output = method.run(analytic_clouds(600)[2].points, 0.5)
    assert output.points.shape == output.normals.shape == (300, 3)


def test_pca_is_better_with_its_k() -> None:
    pytest.importorskip("open3d")
    cloud = analytic_clouds(3000)[3]
    noisy = cloud.noisy(1.0)
    angles = {}
    for method in peer_methods(["pca"]):
        output = method.run(noisy, 1.0)
        assert output.points is noisy
        angles[method.name] = score(noisy, output.normals, cloud.points, cloud.normals).normal_mean or 0.0
    assert min(angles, key=lambda name: angles[name]) == "PCA, k = 100"


def test_neighbours_grow_with_the_noise() -> None:
    assert [peers._neighbours(level, 100_000) for level in (0, 0.1, 1.0, 1.2, 9)] == [24, 60, 120, 240, 480]
    assert peers._neighbours(2.5, 100) == 99
    assert list(NEIGHBOURS) == sorted(NEIGHBOURS)


def test_what_is_missing_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> Any:
        raise ImportError(f"No module named {name!r}")

    with pytest.raises(PcdnfError, match="no peer named 'fet'"):
        peer_methods(["fet"])
    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(PcdnfError, match="jet needs CGAL") as raised:
        peer_methods(["jet"])
    assert "pcdnf[peers]" in (raised.value.hint or "")
