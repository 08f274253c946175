"""Robustness: what its made clouds are, and what its figures say of known clouds."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from experiments.robustness import made_cases, main, middle_part, roughness
from pcdnf.formats import PointCloud, write

COUNT = 6000


def test_made_clouds_are_what_their_names_say() -> None:
    cases = made_cases(COUNT)
    assert len(cases["noise of 4 %"].noisy) == COUNT
    dense = cases["falling density, 0.7 %"].noisy[:, 0]
    assert (dense < -0.25).sum() > 4 * (dense > 0.25).sum() > 0
    assert 0.3 * COUNT < len(cases["holes, 0.7 %"].noisy) < 0.95 * COUNT
    assert 0.15 * COUNT < len(cases["scan lines, 0.7 %"].noisy) < 0.35 * COUNT
    far = np.abs(cases["outliers, 0.5 %"].noisy) < [0.45, 0.3, 0.15]
    assert 0.005 < far.all(axis=1).mean() < 0.02  # inside the block


def test_roughness_is_the_noise_of_a_plane() -> None:
    rng = np.random.default_rng(0)
    plane = np.c_[rng.uniform(0, 3, COUNT), rng.uniform(0, 4, COUNT), np.zeros(COUNT)]
    assert roughness(plane) == pytest.approx(0, abs=1e-6)
    plane[:, 2] = rng.normal(size=COUNT) * 0.005  # of a diagonal of 5
    assert roughness(plane) == pytest.approx(1, rel=0.15)


def test_a_large_scan_is_cut_to_its_middle() -> None:
    line = np.c_[np.arange(101.0), np.zeros(101), np.zeros(101)]
    part = middle_part(PointCloud(points=line, attributes={"row": np.arange(101)}), 11)
    assert part.attributes["row"].tolist() == list(range(45, 56))
    whole = PointCloud(points=line)
    assert middle_part(whole, 101) is whole


@pytest.mark.full
def test_tables_and_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(1)
    scan = np.c_[rng.uniform(size=(5000, 2)), rng.normal(size=5000) * 0.005]
    write(tmp_path / "wall.ply", PointCloud(points=scan))
    few = {name: case for name, case in made_cases(5000).items() if name == "noise of 2 %"}
    monkeypatch.setattr("experiments.robustness.made_cases", lambda _: few)
    monkeypatch.setattr("experiments.robustness.SIZE", (640, 360))
    monkeypatch.setattr(sys, "argv", ["robustness", str(tmp_path / "out"), str(tmp_path / "wall.ply")])
    main()
    made, wall = (
        [float(cell.replace(",", "")) for cell in line.split("|")[2:-1]]
        for line in (tmp_path / "out" / "robustness.md").read_text().splitlines()
        if line.startswith(("| noise", "| wall"))
    )
    assert made[0] == wall[0] == 5000
    assert made[2] < made[1]
    assert wall[2] < 0.8 * wall[1]
    assert sorted(path.name for path in (tmp_path / "out").glob("*.png")) == ["noise-of-2--.png", "wall.png"]
    with Image.open(tmp_path / "out" / "wall.png") as picture:
        assert picture.size == (640, 360)
