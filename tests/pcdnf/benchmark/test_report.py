"""The command end to end on a small cloud: tables, intervals and pictures, the same twice."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pcdnf.benchmark.clouds import analytic_clouds
from pcdnf.cli.main import REFUSED, main

COUNT = 1200


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of one cloud at two levels, with pictures."""
    folder = tmp_path_factory.mktemp("benchmark")
    cloud = analytic_clouds(COUNT)[1]
    np.savez(folder / "can.npz", points=cloud.points, normals=cloud.normals)
    command = [
        "benchmark",
        str(folder / "can.npz"),
        "-o",
        str(folder / "out"),
        "--levels",
        "0,2",
        "--iterations",
        "1,2",
    ]
    assert main([*command, "--peers", "pca", "--pictures", "--device", "cpu"]) == 0
    return folder


def test_tables(folder: Path) -> None:
    table = (folder / "out" / "table.md").read_text()
    assert "| cloud | method | 0 % | 2 % |" in table
    assert "| can | noisy | **0.00** / **0.00** |" in table
    assert "PCA, best k a level" in table
    assert len((folder / "out" / "table.csv").read_text().splitlines()) == 1 + 2 * (1 + 5 + 2)


def test_a_second_pass_has_its_interval(folder: Path) -> None:
    lines = (folder / "out" / "intervals.md").read_text().splitlines()
    rows = [line for line in lines if line.startswith("| can")]
    assert len(rows) == 2
    assert all("| pcdnf-lite x 2 | pcdnf-lite x 1 |" in line for line in rows)


def test_pictures_show_errors_in_colour(folder: Path) -> None:
    pictures = folder / "out" / "pictures"
    assert sorted(path.name for path in pictures.iterdir()) == [
        "can-gaussian-2-normals.png",
        "can-gaussian-2-surface.png",
        "curves-gaussian.png",
    ]
    with Image.open(pictures / "can-gaussian-2-surface.png") as picture:
        colours = np.asarray(picture.convert("RGB"), np.float64)
    half = colours.shape[1] // 2
    saturated = np.ptp(colours, axis=-1) > 60
    assert saturated[:, :half].mean() > 0.1
    red = [(part[..., 0] > part[..., 2] + 60).mean() for part in (colours[:-200, :half], colours[:-200, half:])]
    assert red[0] > 1.5 * red[1]  # ours has fewer large errors


def test_a_second_run_computes_nothing_and_writes_the_same(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = {path: path.read_bytes() for path in (folder / "out").rglob("*") if path.is_file()}
    command = [
        "benchmark",
        str(folder / "can.npz"),
        "-o",
        str(folder / "out"),
        "--levels",
        "0,2",
        "--iterations",
        "1,2",
    ]
    assert main([*command, "--peers", "pca", "--pictures", "--device", "cpu"]) == 0
    assert capsys.readouterr().err.count("(kept)") == 16
    assert {path: path.read_bytes() for path in (folder / "out").rglob("*") if path.is_file()} == before


def test_wrong_usage(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    out = ["-o", str(tmp_path / "out")]
    assert main(["benchmark", str(tmp_path), *out]) == REFUSED
    assert "contains no clean cloud" in capsys.readouterr().err
    assert main(["benchmark", *out, "--noise", "salt"]) == REFUSED
    assert "'salt'" in capsys.readouterr().err
    for wrong in (["--levels", "-1"], ["--iterations", "0"], ["--iterations", "some"]):
        with pytest.raises(SystemExit):
            main(["benchmark", *out, *wrong])
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    assert main(["benchmark", *out, "--pictures"]) == REFUSED
    assert "matplotlib" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
