"""The README's commands do what it says."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from pcdnf.formats import read

ROOT = Path(__file__).resolve().parents[1]
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```", (ROOT / "README.md").read_text(), re.DOTALL | re.MULTILINE)


def block(language: str, word: str) -> str:
    """The one code block of a language that holds a word."""
    (found,) = [text for kind, text in BLOCKS if kind == language and word in text]
    return found


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A working folder that sees the samples as the repository's root does."""
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    return tmp_path


def run(command: list[str], folder: Path) -> str:
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    done = subprocess.run(command, cwd=folder, env=os.environ | {"PATH": path}, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def check(folder: Path, name: str) -> None:
    """The result has the sample's points and colours, normals, and less noise."""
    before, after = read(ROOT / "examples/bracket_noisy.ply"), read(folder / name)
    assert after.points.shape == before.points.shape
    assert after.normals is not None
    assert (after.attributes["red"] == before.attributes["red"]).all()


def test_curl(url: str, folder: Path) -> None:
    commands = block("bash", "curl").replace("http://127.0.0.1:8000", url)
    assert url in commands
    output = run(["bash", "-euo", "pipefail", "-c", commands], folder)
    assert '"status"' in output
    check(folder, "bracket_noisy_denoised.ply")


def test_command_line(folder: Path) -> None:
    output = run(["bash", "-euo", "pipefail", "-c", block("bash", "pcdnf denoise")], folder)
    check(folder, "clean.ply")
    assert (folder / "clean.png").stat().st_size > 50_000
    assert "P2S" in output or "point" in output


def test_python(folder: Path) -> None:
    run([sys.executable, "-c", block("python", "Denoiser")], folder)
    check(folder, "clean.ply")


def test_every_link_leads_somewhere() -> None:
    links = re.findall(r"\]\(([^)#]+)\)", (ROOT / "README.md").read_text())
    assert [link for link in links if "://" not in link and not (ROOT / link).exists()] == []
