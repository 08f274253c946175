"""``pip install 'pcdnf[client]'`` brings nothing that denoises, and what it brings works without."""

from __future__ import annotations

import tomllib
from importlib.metadata import PackageNotFoundError, requires
from pathlib import Path

import numpy as np
import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from pcdnf.errors import EXTRA_OF
from pcdnf.formats import PointCloud, write
from tests.support.blocked import run_without

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
HEAVY = {"torch", "numba", "llvmlite", "scipy", "safetensors", "PIL", "service", "fastapi", "dbos"}
CLIENT = """
import numpy as np
from pcdnf.cli.main import main
from pcdnf.client import Client, Unreachable
from pcdnf.formats import PointCloud, read, write
from pcdnf.formats.flavours import PlyFlavour
write("cloud.ply", PointCloud(points=np.eye(3) + 7, flavour=PlyFlavour()))
assert read("cloud.ply").points.tolist() == (np.eye(3) + 7).tolist()
try:
    Client("http://127.0.0.1:9", patience=0).submit("cloud.ply", {})
except Unreachable as error:
    print(error.code)
"""


def closure(lines: list[str], extra: str = "") -> set[str]:
    """Distributions that these requirements bring, of those that are installed here."""
    found: set[str] = set()
    todo = [(line, extra) for line in lines]
    while todo:
        line, extra = todo.pop()
        requirement = Requirement(line)
        name = canonicalize_name(requirement.name)
        if name in found or not (requirement.marker is None or requirement.marker.evaluate({"extra": extra})):
            continue
        found.add(name)
        try:
            inner = requires(name) or []
        except PackageNotFoundError:
            continue
        todo += [(line, each) for line in inner for each in requirement.extras or {""}]
    return found


def test_the_client_requires_no_library_that_denoises() -> None:
    light = closure(PROJECT["dependencies"] + PROJECT["optional-dependencies"]["client"])
    assert {"numpy", "httpx", "pydantic"} <= light
    assert not light & {"torch", "numba", "llvmlite", "scipy", "safetensors", "pillow", "fastapi", "dbos"}


def test_the_extra_denoise_requires_what_denoises() -> None:
    names = {Requirement(line).name for line in PROJECT["optional-dependencies"]["denoise"]}
    assert {"torch", "numba", "scipy", "safetensors", "pillow"} <= names


def test_torch_has_a_lower_bound_here_and_its_pin_among_the_constraints() -> None:
    (torch,) = [line for line in PROJECT["optional-dependencies"]["denoise"] if line.startswith("torch")]
    assert torch.startswith("torch>=")
    pins = (ROOT / "docker" / "constraints.txt").read_text().splitlines()
    (pin,) = [line.removeprefix("torch==") for line in pins if line.startswith("torch==")]
    assert pin in Requirement(torch).specifier
    assert "--constraint docker/constraints.txt" in (ROOT / "scripts" / "_setup").read_text()


def test_client_and_formats_work_without_torch_numba_and_scipy(tmp_path: Path) -> None:
    done = run_without(HEAVY, CLIENT, tmp_path)
    assert (done.returncode, done.stdout) == (0, "unreachable\n"), done.stderr


@pytest.mark.parametrize("command", ["--help", "--version", "submit --help", "jobs --help", "denoise --help"])
def test_the_command_explains_itself_without_them(command: str, tmp_path: Path) -> None:
    done = run_without(HEAVY, f"from pcdnf.cli.main import main\nmain({command.split()!r})", tmp_path)
    assert done.returncode == 0, done.stderr
    assert "pcdnf" in done.stdout


def test_denoising_without_its_libraries_names_the_extra(tmp_path: Path) -> None:
    program = "from pcdnf.cli.main import main\nraise SystemExit(main(['denoise', 'a.ply', '-o', 'b.ply']))"
    write(tmp_path / "a.ply", PointCloud(points=np.eye(3)))
    done = run_without(HEAVY, program, tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith("pcdnf: This needs ")
    assert "pip install 'pcdnf[denoise]'" in done.stderr


def test_the_denoiser_without_its_libraries_names_the_extra(tmp_path: Path) -> None:
    program = """
from pcdnf.errors import MissingExtra
try:
    from pcdnf import Denoiser
except MissingExtra as error:
    print(error.hint)
"""
    done = run_without(HEAVY, program, tmp_path)
    assert done.stdout == "Run: pip install 'pcdnf[denoise]'\n", done.stderr


def test_every_extra_that_a_message_names_exists() -> None:
    assert set(EXTRA_OF.values()) <= set(PROJECT["optional-dependencies"])
