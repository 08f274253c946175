"""The README's commands do what it says, and its waiting loop, which other pages repeat, ends however the job ends."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from fastapi import FastAPI, Request

from pcdnf.formats import read
from service.settings import Settings
from tests.support.clouds import thinned_examples
from tests.support.service_process import Served

ROOT = Path(__file__).resolve().parents[1]
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```", (ROOT / "README.md").read_text(), re.DOTALL | re.MULTILINE)


WITH_LOOPS = ("README.md", "docs/api.md", "docs/tutorial.md")
LOOP_SECONDS = 60
POINTS = 2000


def block(language: str, word: str) -> str:
    """The one code block of a language that holds a word."""
    (found,) = [text for kind, text in BLOCKS if kind == language and word in text]
    return found


@pytest.fixture(scope="module")
def examples(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The samples, thinned."""
    return thinned_examples(tmp_path_factory.mktemp("samples"), POINTS)


@pytest.fixture
def folder(tmp_path: Path, examples: Path) -> Path:
    """A working folder that sees the samples as the repository's root does."""
    (tmp_path / "examples").symlink_to(examples)
    return tmp_path


def run(command: list[str], folder: Path) -> str:
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    done = subprocess.run(command, cwd=folder, env=os.environ | {"PATH": path}, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def check(folder: Path, name: str) -> None:
    """The result has the sample's points and colours, normals, and less noise."""
    before, after = read(folder / "examples/bracket_noisy.ply"), read(folder / name)
    assert after.points.shape == before.points.shape
    assert after.normals is not None
    assert (after.attributes["red"] == before.attributes["red"]).all()


def test_curl(url: str, folder: Path) -> None:
    commands = block("bash", "curl").replace("http://127.0.0.1:8000", url)
    assert url in commands
    run(["bash", "-euo", "pipefail", "-c", commands], folder)
    check(folder, "bracket_noisy_denoised.ply")


def curl_block(page: str) -> str:
    """The block of a page that submits, waits and fetches."""
    found = re.findall(r"^```(?:sh|bash)\n(.*?)^```", (ROOT / page).read_text(), re.DOTALL | re.MULTILINE)
    (text,) = [text for text in found if "/denoise" in text and "; do" in text]
    return str(text)


def failing_service() -> FastAPI:
    """A service whose jobs run for two looks and then fail."""
    app = FastAPI()
    app.state.settings = Settings()
    app.state.looks = 0

    @app.post("/denoise", status_code=202)
    def denoise() -> dict[str, str]:
        return {"id": "0" * 32}

    @app.get("/jobs/{job}")
    def job(job: str, request: Request) -> dict[str, object]:
        request.app.state.looks += 1
        status = "running" if request.app.state.looks < 3 else "failed"
        return {"id": job, "status": status, "problem": {"status": 500, "code": "worker_lost"}}

    @app.get("/jobs/{job}/result", status_code=409)
    def result(job: str) -> dict[str, str]:
        return {"id": job, "code": "job_failed"}

    return app


def wait_in_vain(page: str, address: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a page's block as a reader pastes it, without ``set -e``."""
    text = curl_block(page).replace("http://127.0.0.1:8000", address.rstrip("/"))
    return subprocess.run(["bash", "-c", text], cwd=folder, capture_output=True, text=True, timeout=LOOP_SECONDS)


@pytest.mark.parametrize("page", WITH_LOOPS)
def test_the_loop_ends_when_the_job_fails(page: str, folder: Path) -> None:
    (folder / "scan.ply").write_text("a scan")
    app = failing_service()
    with Served(app) as client:
        done = wait_in_vain(page, str(client.base_url), folder)
    assert app.state.looks >= 3
    assert done.returncode != 0
    assert "409" in done.stderr
    assert not list(folder.glob("*_denoised.ply"))


@pytest.mark.parametrize("page", WITH_LOOPS)
def test_the_loop_ends_when_the_file_is_refused(page: str, url: str, tmp_path: Path) -> None:
    (tmp_path / "examples").mkdir()
    for name in ("scan.ply", "examples/bracket_noisy.ply", "examples/scan_boxes.ply"):
        (tmp_path / name).write_text("not a cloud")
    done = wait_in_vain(page, url, tmp_path)
    assert done.returncode != 0
    assert not list(tmp_path.glob("*_denoised.ply"))


def test_command_line(folder: Path) -> None:
    output = run(["bash", "-euo", "pipefail", "-c", block("bash", "pcdnf denoise")], folder)
    check(folder, "clean.ply")
    assert (folder / "clean.png").stat().st_size > 50_000
    assert "points" in output


def test_python(folder: Path) -> None:
    run([sys.executable, "-c", block("python", "Denoiser")], folder)
    check(folder, "clean.ply")


def rows(page: str, first: int) -> dict[str, list[str]]:
    """The cells of each table row of a page, by the text of the cells before ``first``."""
    found = {}
    for line in (ROOT / page).read_text().splitlines():
        cells = [cell.strip().replace("*", "") for cell in line.strip("|").split("|")]
        if line.startswith("|") and len(cells) > first:
            found[" ".join(cells[:first]).strip()] = cells[first:]
    return found


def test_the_table_holds_the_means_of_the_benchmark() -> None:
    levels = ["0.25", "0.5", "1", "1.5", "2.5"]
    text = (ROOT / "docs/benchmark.md").read_text()
    table = text[text.index("## Results") : text.index("## Both networks")]
    figures = {
        kind: [
            [float(cell.split("/")[part]) for cell in line.replace("*", "").strip("|").split("|")[2:]]
            for line in table.splitlines()
            if line.startswith("|") and line.split("|")[2].strip() == kind
        ]
        for kind, part in {"best peer": 1, "ours": 1, "normals, PCA, best k": 0, "normals, ours": 0}.items()
    }
    assert {len(clouds) for clouds in figures.values()} == {5}
    shown = {level: cells for level, cells in rows("README.md", 1).items() if level in levels}
    assert set(shown) == {"0.5", "1", "2.5"}
    for level, cells in shown.items():
        column = levels.index(level)
        for cell, kind in zip(cells[2:], figures, strict=True):
            mean = sum(cloud[column] for cloud in figures[kind]) / 5
            assert float(cell) == pytest.approx(mean, abs=0.06 if kind.startswith("normals") else 0.006), (level, kind)
    means = rows("docs/benchmark.md", 2)["mean CD: best peer, ours"]
    assert {level: ", ".join(cells[:2]) for level, cells in shown.items()} == {
        level: means[levels.index(level)] for level in shown
    }


def test_every_link_leads_somewhere() -> None:
    links = re.findall(r"\]\(([^)#]+)\)", (ROOT / "README.md").read_text())
    assert [link for link in links if "://" not in link and not (ROOT / link).exists()] == []
