"""The applications: after denoising each comes nearer to the truth than before."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from PIL import Image

from pcdnf import Denoiser

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


@pytest.fixture
def applications(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The example, with fewer scans."""
    pytest.importorskip("open3d")
    monkeypatch.syspath_prepend(str(EXAMPLES))
    import applications

    monkeypatch.setattr(applications, "SCANS", 2)
    monkeypatch.setattr(applications, "SAMPLES", 8000)
    return applications


def test_a_clean_scan_is_as_good_as_it_gets(applications: ModuleType) -> None:
    part = applications.Part()
    scan = part.sample(6000, 0.0, seed=1)
    assert part.distance(scan.clean).mean() < 1e-5
    assert part.distance(scan.clean + part.normals_near(scan.clean) * 0.01).mean() == pytest.approx(0.01, rel=0.1)
    assert (scan.facet >= 0).mean() > 0.5
    figures = applications.plane_fitting(part, scan, scan.points, scan.normals).figures
    assert figures["plane angle, degrees"] < 0.1
    assert figures["share of a plane's points found, %"] > 95
    assert applications.reconstruction(part, scan.points, scan.normals).figures["mesh to surface x 1e3"] < 3


@pytest.mark.full
def test_denoising_helps(applications: ModuleType, tmp_path: Path) -> None:
    denoiser = Denoiser.load(device="cpu")

    def denoise(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        result = denoiser.denoise(points, iterations=2)
        return result.points, result.normals.astype(np.float64)

    outcomes = applications.run(denoise, points=8000, noise=1.0)
    assert list(outcomes) == ["Poisson reconstruction", "RANSAC planes", "Registration"]
    before, after = (outcomes["RANSAC planes"][which].figures for which in (0, 1))
    assert after["plane angle, degrees"] < before["plane angle, degrees"]
    assert after["share of a plane's points found, %"] > 1.3 * before["share of a plane's points found, %"]
    before, after = (outcomes["Registration"][which].figures for which in (0, 1))
    for key in before:
        assert after[key] < before[key], key
    before, after = (outcomes["Poisson reconstruction"][which].figures for which in (0, 1))
    assert after["mesh normals, degrees"] < before["mesh normals, degrees"]
    assert applications.table(outcomes).count("\n") == 2 + 3 + 3 + 4
    applications.draw(outcomes, tmp_path / "applications.png")
    with Image.open(tmp_path / "applications.png") as picture:
        assert picture.size == (3 * 620, 2 * 620)
