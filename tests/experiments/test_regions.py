"""A region is what the whole cloud's denoising makes of it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from experiments.regions import denoised, measure, rows_of
from pcdnf import Denoiser
from pcdnf.benchmark.clouds import analytic_clouds


@pytest.fixture(scope="module")
def lite() -> Denoiser:
    return Denoiser.load("pcdnf-lite", device="cpu", precision="float32")


def test_regions_equal_the_whole(lite: Denoiser) -> None:
    cloud = analytic_clouds(6000)[0]
    noisy = cloud.noisy(1.0)
    rows = rows_of(cKDTree(noisy), np.array([10, 4000]), 60)
    assert 60 <= len(rows) <= 120
    whole = lite.denoise(noisy)
    assert int(whole.metadata["iterations"]) > 1
    points, normals = denoised(lite, noisy, rows)
    np.testing.assert_allclose(points, whole.points[rows], atol=1e-6)
    np.testing.assert_allclose(normals, whole.normals[rows], atol=1e-4)


def test_a_line_compares_both(lite: Denoiser) -> None:
    line = measure(analytic_clouds(3000)[0], 1.0, {"a": lite, "b": lite}, regions=1, points=50)
    assert line.startswith("| ")
    assert line.endswith("| 1.00 |")
