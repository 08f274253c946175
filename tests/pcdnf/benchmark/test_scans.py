"""Scans against their truth: scores, and the command end to end."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pcdnf.benchmark.methods import Output
from pcdnf.benchmark.scans import FIRST_SEED, TrueScan, read_scans, simulated_scans, thinned
from pcdnf.cli.main import main
from pcdnf.errors import PcdnfError
from pcdnf.scanners.scan import Scan, save_scan


@pytest.fixture(scope="module")
def scan() -> Scan:
    (scan,) = simulated_scans(["depth-frame"], 1, 4000)
    return scan


def test_the_truth_itself_scores_nothing_and_the_scan_its_noise(scan: Scan) -> None:
    truth = TrueScan(scan)
    best = truth.score(Output(scan.clean, scan.normals))
    assert best.distance < 0.05
    assert best.worse_by_sigma == 0
    assert best.angle < 1e-3
    before = truth.score(Output(scan.points, scan.normals))
    good = ~scan.mixed
    assert before.distance == pytest.approx(1000 * truth.before[good].mean())
    assert (before.worse, before.worse_by_sigma) == (0, 0)
    assert before.thin == pytest.approx(1000 * truth.before[good & scan.thin].mean())


def test_points_moved_away_by_more_than_their_sigma_are_counted(scan: Scan) -> None:
    truth, good = TrueScan(scan), ~scan.mixed
    moved = scan.clean.copy()
    far = np.flatnonzero(good)[::4]
    moved[far] = scan.points[far] + 40 * scan.sigma[far, None] * scan.normals[far]
    result = truth.score(Output(moved, scan.normals))
    assert result.worse_by_sigma is not None
    assert result.worse_by_sigma == pytest.approx(0.25, abs=0.03)
    assert result.worse is not None
    assert result.worse >= result.worse_by_sigma


def test_a_result_of_other_points_has_a_distance_alone(scan: Scan) -> None:
    result = TrueScan(scan).score(Output(scan.points[::2], scan.normals[::2]))
    assert result.worse is result.worse_by_sigma is result.thin is None
    assert result.distance > 0
    assert result.points == len(scan.points[::2])


def test_a_thinned_scan_is_a_piece_at_its_own_density(scan: Scan) -> None:
    piece = thinned(scan, 900)
    assert len(piece.points) == 900
    middle = scan.points[len(scan.points) // 2]
    reach = np.linalg.norm(piece.points - middle, axis=1).max()
    assert (np.linalg.norm(scan.points - middle, axis=1) <= reach).sum() == 900
    assert thinned(scan, 10**6) is scan


def test_a_folder_without_scans_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PcdnfError, match="holds no scan"):
        read_scans([tmp_path])


def test_the_command_writes_tables_and_pictures_and_keeps_what_is_there(
    scan: Scan, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_scan(tmp_path / "scan.npz", thinned(scan, 1500))
    command = ["benchmark", "--scanners", str(tmp_path / "scan.npz"), "-o", str(tmp_path / "out"), "--device", "cpu"]
    assert main([*command, "--peers", "plane", "--pictures"]) == 0
    table = (tmp_path / "out" / "scans.md").read_text()
    assert f"| method | depth-frame-{FIRST_SEED} (mm) |" in table
    for method in ("noisy", "PCA plane, best k", "pcdnf-lite auto"):
        assert f"| {method} | " in table
    assert "| PCA plane, best k | k = " in table
    assert len((tmp_path / "out" / "scans.csv").read_text().splitlines()) == 4
    assert (tmp_path / "out" / "pictures" / f"depth-frame-{FIRST_SEED}.png").stat().st_size > 10_000
    assert "(kept)" not in capsys.readouterr().err
    assert main([*command, "--peers", "plane"]) == 0
    assert capsys.readouterr().err.count("(kept)") == 3
    assert (tmp_path / "out" / "scans.md").read_text() == table
