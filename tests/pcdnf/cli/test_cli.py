"""The command line: run in this process where possible, and once as a user does."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from pcdnf import __version__
from pcdnf.cli.main import INTERRUPTED, REFUSED, main
from pcdnf.formats import PlyFlavour, PointCloud, read, write

COUNT = 600
KEYS = {"model", "weights_sha256", "version", "device", "precision", "iterations", "seed"}


def wave(noise: float = 0.0) -> np.ndarray[Any, np.dtype[np.float64]]:
    rng = np.random.default_rng(0)
    plane = rng.uniform(-1, 1, size=(COUNT, 2))
    points = np.c_[plane, 0.2 * np.sin(2 * plane[:, 0])]
    return points + rng.normal(size=points.shape) * noise


@pytest.fixture
def noisy(tmp_path: Path) -> Path:
    """A text PLY with colours, a comment and coordinates far from the origin."""
    cloud = PointCloud(
        points=wave(0.01) + np.array([500_000, 4_480_000, 100]),
        attributes={"red": np.arange(COUNT, dtype=np.uint16).astype(np.uint8), "intensity": np.ones(COUNT, np.float32)},
        comments=["survey 12"],
        flavour=PlyFlavour("ascii"),
    )
    write(tmp_path / "noisy.ply", cloud)
    return tmp_path / "noisy.ply"


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    assert main([str(argument) for argument in arguments]) == REFUSED
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("pcdnf: ")
    assert captured.err.count("\n") == 1
    return captured.err


# denoise


def test_denoise_keeps_everything_and_says_how(noisy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output, picture = tmp_path / "out.ply", tmp_path / "out.png"
    assert (
        main(["denoise", str(noisy), "-o", str(output), "--seed", "5", "--device", "cpu", "--picture", str(picture)])
        == 0
    )
    before, after = read(noisy), read(output)
    assert isinstance(after.flavour, PlyFlavour)
    assert after.flavour.encoding == "ascii"
    assert [name for name, _ in after.flavour.properties] == ["x", "y", "z", "nx", "ny", "nz", "red", "intensity"]
    assert after.comments == ["survey 12"]
    for name, column in before.attributes.items():
        np.testing.assert_array_equal(after.attributes[name], column)
    assert after.points.dtype == np.float64
    moved = np.linalg.norm(after.points - before.points, axis=1)
    assert 0 < moved.max() < 0.2
    assert after.normals is not None
    np.testing.assert_allclose(np.linalg.norm(after.normals, axis=1), 1, atol=1e-5)
    assert after.metadata.keys() >= KEYS
    assert (after.metadata["seed"], after.metadata["device"]) == ("5", "cpu")
    assert [after.metadata[key] for key in ("normals", "orient", "outliers")] == ["auto", "off", "keep"]
    assert after.metadata["version"] == __version__
    with Image.open(picture) as drawn:
        assert drawn.size == (2250, 900), "before, after and the map of displacement"
    assert f"{COUNT} points in" in capsys.readouterr().out


def test_what_was_done_to_each_point_is_added_on_request(
    noisy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "out.ply"
    assert main(["denoise", str(noisy), "-o", str(output), "--device", "cpu", "--diagnostics"]) == 0
    before, after = read(noisy), read(output)
    moved = np.linalg.norm(after.points - before.points, axis=1)
    np.testing.assert_allclose(after.attributes["displacement"], moved, atol=1e-6)
    confidence, noise = after.attributes["confidence"], after.attributes["estimated_noise"]
    assert 0 <= confidence.min() <= confidence.max() <= 1
    assert (confidence[moved <= 2 * noise] == 1)[moved[moved <= 2 * noise] > 0].all()
    head = output.read_bytes().partition(b"end_header")[0].decode()
    names = ["scalar_displacement", "scalar_estimated_noise", "scalar_confidence"]
    assert re.findall(r"property float (scalar_\w+)", head) == names, "CloudCompare shows only these"
    told = capsys.readouterr().out
    assert f"points moved: {after.metadata['moved']}, left: {after.metadata['left']}" in told


def test_faint_splats_do_not_pull_the_surface(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    surface = wave(0.01)
    floaters = surface + np.array([0, 0, 0.04])
    logits = np.repeat([4.0, -4.0], COUNT)
    columns = {name: np.ones(2 * COUNT, np.float32) for name in ("f_dc_0", "scale_0", "rot_0")}
    splats = PointCloud(
        points=np.concatenate([surface, floaters]), attributes=columns | {"opacity": logits.astype(np.float32)}
    )
    write(tmp_path / "splats.ply", splats)
    write(tmp_path / "surface.ply", PointCloud(points=surface))
    for name in ("splats", "surface"):
        assert main(["denoise", str(tmp_path / f"{name}.ply"), "-o", str(tmp_path / f"{name}_out.ply"), "--quiet"]) == 0
    found, expected = read(tmp_path / "splats_out.ply"), read(tmp_path / "surface_out.ply")
    np.testing.assert_array_equal(found.points[:COUNT], expected.points)
    np.testing.assert_array_equal(found.points[COUNT:], floaters)
    assert f"{COUNT} of {2 * COUNT} splats have an opacity below 10%" in capsys.readouterr().err


def test_the_name_of_the_output_picks_the_format(
    noisy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, format_ in (("out.npz", "npz"), ("out", "ply")):
        assert main(["denoise", str(noisy), "-o", str(tmp_path / name), "--quiet", "--device", "cpu"]) == 0
        assert read(tmp_path / name).flavour.format == format_
    assert capsys.readouterr().out == ""


def test_another_extension_of_text_has_a_layout_of_its_own(tmp_path: Path) -> None:
    rows = "".join(f"{x} {y} {z} -900\n" for x, y, z in wave(0.01))
    (tmp_path / "a.pts").write_text(f"{COUNT}\n{rows}")
    (tmp_path / "a.txt").write_text(rows.replace(" ", ","))
    for source, name in (("a.pts", "b.xyz"), ("a.txt", "c.txt"), ("a.txt", "c.xyz")):
        paths = [str(tmp_path / source), "-o", str(tmp_path / name)]
        assert main(["denoise", *paths, "--quiet", "--iterations", "1"]) == 0
    assert read(tmp_path / "b.xyz").normals is not None, "a PTS has no place for them, an XYZ has"
    assert "," in (tmp_path / "c.txt").read_text()
    assert "," not in (tmp_path / "c.xyz").read_text()


def test_a_result_is_repeatable_and_its_metadata_do_not_pile_up(noisy: Path, tmp_path: Path) -> None:
    first, second = tmp_path / "a.ply", tmp_path / "b.ply"
    for output in (first, second):
        assert main(["denoise", str(noisy), "-o", str(output), "--device", "cpu", "--iterations", "2", "--quiet"]) == 0
    assert first.read_bytes() == second.read_bytes()
    assert (
        main(
            [
                "denoise",
                str(first),
                "-o",
                str(second),
                "--device",
                "cpu",
                "--normals",
                "input",
                "--quiet",
                "--iterations",
                "1",
            ]
        )
        == 0
    )
    again = read(second)
    assert again.metadata["iterations"] == "1"
    assert second.read_text().count("comment pcdnf seed") == 1


def test_denoise_refuses_with_one_line(noisy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "out.ply"
    assert "cannot be read" in refused(capsys, "denoise", tmp_path / "none.ply", "-o", output)
    assert "no normals" in refused(capsys, "denoise", noisy, "-o", output, "--normals", "input")
    assert "folder does not exist" in refused(capsys, "denoise", noisy, "-o", tmp_path / "no" / "out.ply")
    assert "end in .obj cannot be written" in refused(capsys, "denoise", noisy, "-o", tmp_path / "out.obj")
    assert "is a folder" in refused(capsys, "denoise", noisy, "-o", tmp_path)
    assert "pcdnf: " in refused(capsys, "denoise", noisy, "-o", output, "--model", "no-such-model")
    assert "device" in refused(capsys, "denoise", noisy, "-o", output, "--device", "cuda:99")
    write(tmp_path / "few.ply", PointCloud(points=wave()[:5]))
    assert "5 points" in refused(capsys, "denoise", tmp_path / "few.ply", "-o", output)
    assert not output.exists()


def test_rows_that_are_not_finite(noisy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cloud = read(noisy)
    cloud.points[7, 1] = np.nan
    write(noisy, cloud)
    output = tmp_path / "out.ply"
    assert "row 7 " in refused(capsys, "denoise", noisy, "-o", output, "--nonfinite", "reject")
    assert main(["denoise", str(noisy), "-o", str(output), "--nonfinite", "drop", "--device", "cpu"]) == 0
    assert "left out: 7 (1 row)" in capsys.readouterr().err
    after = read(output)
    assert len(after) == COUNT - 1
    assert after.metadata["dropped_rows"] == "7 (1 row)"


@pytest.mark.parametrize("wrong", [["--iterations", "0"], ["--seed", "-1"], ["--precision", "float8"], []])
def test_wrong_usage(noisy: Path, wrong: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["denoise", str(noisy), *wrong])
    assert ended.value.code == 2
    assert "usage: pcdnf denoise" in capsys.readouterr().err


def test_an_interrupt_leaves_nothing_behind(
    noisy: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    request: pytest.FixtureRequest,
) -> None:
    from tqdm import tqdm

    def interrupt(*_: object) -> None:
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(tqdm, "update", interrupt)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # it may be ignored: a job in the background
    request.addfinalizer(lambda: signal.signal(signal.SIGINT, before))
    assert main(["denoise", str(noisy), "-o", str(tmp_path / "out.ply"), "--device", "cpu"]) == INTERRUPTED
    assert sorted(path.name for path in tmp_path.iterdir()) == ["noisy.ply"]
    assert "nterrupted" in capsys.readouterr().err


def test_a_full_disk_is_reported(
    noisy: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    output = noisy.with_name("out.ply")
    assert "No space left" in refused(capsys, "denoise", noisy, "-o", output, "--device", "cpu")
    assert sorted(path.name for path in noisy.parent.iterdir()) == ["noisy.ply"]


# the other commands


def test_evaluate_prints_scores(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    np.save(tmp_path / "clean.npy", wave().astype(np.float32))
    write(tmp_path / "noisy.npz", PointCloud(points=wave(0.01), normals=np.tile([0.0, 0, 1], (COUNT, 1))), format="npz")
    assert main(["evaluate", str(tmp_path / "noisy.npz"), str(tmp_path / "clean.npy"), "--json"]) == 0
    scores = json.loads(capsys.readouterr().out)
    assert scores["points"] == COUNT
    assert 0 < scores["point_to_surface"] < 10
    assert 0 < scores["normal_mean"] < scores["normal_rms"] < 30
    assert main(["evaluate", str(tmp_path / "clean.npy"), str(tmp_path / "clean.npy")]) == 0
    assert "Chamfer distance   0.000 x 1e-5" in capsys.readouterr().out


def test_evaluate_refuses_other_arrays(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for array, words in ((np.zeros((5, 2)), "(N, 3)"), (np.array([{}], dtype=object), "Python objects")):
        np.save(tmp_path / "array.npy", array)
        assert words in refused(capsys, "evaluate", tmp_path / "array.npy", tmp_path / "array.npy")
    assert "cannot be read" in refused(capsys, "evaluate", tmp_path / "none.npy", tmp_path / "none.npy")
    np.save(tmp_path / "good.npy", wave())
    for array, why in ((np.full((5, 3), np.nan), "0 points"), (np.zeros((0, 3)), "0 points")):
        np.save(tmp_path / "array.npy", array)
        assert why in refused(capsys, "evaluate", tmp_path / "array.npy", tmp_path / "good.npy")
        assert why in refused(capsys, "evaluate", tmp_path / "good.npy", tmp_path / "array.npy")
        assert why in refused(capsys, "render", tmp_path / "array.npy", "-o", tmp_path / "out.png")


def test_models_are_listed_the_default_first(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["models", "--json"]) == 0
    models = json.loads(capsys.readouterr().out)
    assert all(len(model["sha256"]) == 64 and model["licence"] for model in models)
    assert main(["models"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(f"{models[0]['name']} (default): ")


def test_released_weights_can_be_imported_and_used(
    shared_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    weights = tmp_path / "released.safetensors"
    assert main(["import-weights", str(shared_data / "release_vector.pth"), "-o", str(weights)]) == 0
    write(tmp_path / "in.ply", PointCloud(points=wave(0.01)[:150]))
    arguments = [
        "denoise",
        str(tmp_path / "in.ply"),
        "-o",
        str(tmp_path / "out.ply"),
        "--model",
        str(weights),
        "--device",
        "cpu",
    ]
    assert main(arguments) == 0
    assert read(tmp_path / "out.ply").metadata["model"] == "released"
    capsys.readouterr()
    (tmp_path / "other.pth").write_bytes(b"not a checkpoint")
    refused(capsys, "import-weights", tmp_path / "other.pth", "-o", tmp_path / "x.safetensors")


def test_benchmark_refuses_with_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").touch()
    assert "cannot be created" in refused(capsys, "benchmark", "-o", tmp_path / "file")
    for option in ("--points", "--generated"):
        with pytest.raises(SystemExit) as ended:
            main(["benchmark", "-o", str(tmp_path / "out"), option, "-3"])
        assert ended.value.code == 2
        assert "whole number of at least 1" in capsys.readouterr().err


def test_training_has_its_options(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["train", "--help"])
    assert ended.value.code == 0
    assert "--minutes" in capsys.readouterr().out


def test_commands_of_other_packages_are_found(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--help"])
    assert "serve" in capsys.readouterr().out


def test_as_a_user_runs_it(noisy: Path, tmp_path: Path) -> None:
    command = [
        sys.executable,
        "-m",
        "pcdnf.cli",
        "denoise",
        str(noisy),
        "-o",
        str(tmp_path / "out.npz"),
        "--device",
        "cpu",
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    first, second, third = done.stdout.splitlines()
    assert first.endswith(f": {tmp_path / 'out.npz'}")
    assert re.fullmatch(r"noise about 0\.0\d+; iterations: \d, radius: about [0-9., ]+", second)
    assert re.fullmatch(r"points moved: [0-9.]+%, left: [0-9.]+%, moved doubtfully far: [0-9.]+%", third)
    with np.load(tmp_path / "out.npz", allow_pickle=False) as arrays:
        assert {f"pcdnf_{key}" for key in KEYS} <= set(arrays)
        assert arrays["points"].dtype == np.float64
