"""The wheel and the source distribution hold what they should, and the installed wheel denoises."""

from __future__ import annotations

import email
import os
import re
import runpy
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import zipfile
from email.message import Message
from pathlib import Path

import numpy as np
import pytest

from pcdnf import __version__
from pcdnf.formats import PointCloud, read, write
from tests.support.service_process import sphere

ROOT = Path(__file__).resolve().parents[2]
BUILD = "import sys; from setuptools import build_meta; print(getattr(build_meta, sys.argv[1])(sys.argv[2]))"
COUNT = 1500


def build(hook: str, source: Path, target: Path) -> Path:
    """What a build frontend does with a source tree, less the isolated environment."""
    done = subprocess.run(
        [sys.executable, "-c", BUILD, hook, str(target)], cwd=source, capture_output=True, text=True, timeout=240
    )
    assert done.returncode == 0, done.stderr
    return target / done.stdout.splitlines()[-1]


@pytest.fixture(scope="module")
def source_archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The source distribution, built from the files that git knows or would add."""
    tree = tmp_path_factory.mktemp("tree")
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    for name in filter(None, listed.split("\0")):
        if (ROOT / name).is_file() and not name.startswith(("docs/", "tests/")):
            (tree / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, tree / name)
    return build("build_sdist", tree, tmp_path_factory.mktemp("sdist"))


@pytest.fixture(scope="module")
def wheel(source_archive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built from the source distribution alone."""
    folder = tmp_path_factory.mktemp("unpacked")
    with tarfile.open(source_archive) as archive:
        archive.extractall(folder, filter="data")
    return build("build_wheel", next(folder.iterdir()), tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def metadata(wheel: Path) -> Message:
    with zipfile.ZipFile(wheel) as archive:
        (name,) = [name for name in archive.namelist() if name.endswith(".dist-info/METADATA")]
        return email.message_from_bytes(archive.read(name))


@pytest.fixture(scope="module")
def environment(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A virtual environment with the wheel, and this environment's libraries without its editable install."""
    folder = tmp_path_factory.mktemp("environment") / "venv"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True)
    python = folder / "bin" / "python"
    install = [sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "--no-deps", "--no-index", wheel]
    subprocess.run(install, cwd=folder, env=without_python_settings(), check=True)
    packages = next((folder / "lib").glob("python3*/site-packages"))
    # Paths named in a .pth file are searched, but the .pth files in them are not read.
    (packages / "libraries.pth").write_text(sysconfig.get_path("purelib") + "\n")
    adopt_kernels(packages)
    return folder


def without_python_settings() -> dict[str, str]:
    """The environment without what would lead Python to this repository."""
    return {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "PCDNF_"))}


def adopt_kernels(packages: Path) -> None:
    """Give the installed copy the kernels that Numba has compiled for the same sources, which saves a minute."""
    for kernel in ROOT.glob("pcdnf/**/__pycache__/*.nb[ci]"):
        target = packages / kernel.relative_to(ROOT)
        target.parent.mkdir(exist_ok=True)
        shutil.copy2(kernel, target)
    for source in ROOT.glob("pcdnf/**/*.py"):
        shutil.copystat(source, packages / source.relative_to(ROOT))


def run(environment: Path, folder: Path, *words: object) -> subprocess.CompletedProcess[str]:
    """Run a program of the clean environment, away from the repository."""
    program, *arguments = map(str, words)
    return subprocess.run(
        [environment / "bin" / program, *arguments],
        cwd=folder,
        env=without_python_settings(),
        capture_output=True,
        text=True,
        timeout=280,
    )


def names_in(wheel: Path) -> list[str]:
    with zipfile.ZipFile(wheel) as archive:
        return archive.namelist()


def test_the_wheel_has_one_top_level_package(wheel: Path) -> None:
    tops = {name.partition("/")[0] for name in names_in(wheel)}
    assert tops == {"pcdnf", f"pcdnf-{__version__}.dist-info"}


def test_the_wheel_has_every_module_the_weights_the_types_and_the_licence(wheel: Path) -> None:
    names = set(names_in(wheel))
    modules = {str(path.relative_to(ROOT)) for path in ROOT.glob("pcdnf/**/*.py")}
    assert modules - names == set()
    assert {"pcdnf/py.typed", "pcdnf/weights/index.json", "pcdnf/weights/pcdnf-lite.safetensors"} <= names
    assert f"pcdnf-{__version__}.dist-info/licenses/LICENSE" in names


def test_the_source_distribution_has_licence_changes_and_citation_and_no_tests(source_archive: Path) -> None:
    with tarfile.open(source_archive) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert {"LICENSE", "README.md", "CHANGELOG.md", "CITATION.cff", "setup.py", "pyproject.toml"} <= names
    assert not [name for name in names if name.startswith(("tests/", "service/"))]


def test_the_metadata_say_what_an_index_shows(metadata: Message) -> None:
    assert metadata["Name"] == "pcdnf"
    assert metadata["Version"] == __version__
    assert metadata["License-Expression"] == "MIT"
    assert [field for field in ("Author", "Summary", "Keywords") if not metadata[field]] == []
    assert metadata["Description-Content-Type"] == "text/markdown"
    assert "Typing :: Typed" in metadata.get_all("Classifier", [])
    assert any("10.1109/TVCG.2023.3292464" in url for url in metadata.get_all("Project-URL", []))
    assert {"denoise", "client", "las", "e57"} <= set(metadata.get_all("Provides-Extra", []))


def test_the_readme_of_the_package_has_no_link_that_needs_the_repository(metadata: Message) -> None:
    text = str(metadata.get_payload())
    assert text.startswith("# PCDNF")
    assert [link for link in re.findall(r"\]\(([^)]+)\)", text) if not re.match("https?://|#", link)] == []


def test_links_become_absolute_once_the_project_has_an_address() -> None:
    portable = runpy.run_path(str(ROOT / "setup.py"))["portable_readme"]
    text = "![Bracket](docs/images/b.png) [API](docs/api.md) [paper](https://doi.org/1) [below](#below)"
    assert portable(text, None) == " API [paper](https://doi.org/1) [below](#below)"
    assert portable(text, "https://forge.example/pcdnf/") == (
        "![Bracket](https://forge.example/pcdnf/raw/HEAD/docs/images/b.png) "
        "[API](https://forge.example/pcdnf/blob/HEAD/docs/api.md) [paper](https://doi.org/1) [below](#below)"
    )


def test_the_installed_wheel_is_what_runs(environment: Path, tmp_path: Path) -> None:
    done = run(environment, tmp_path, "python", "-c", "import pcdnf; print(pcdnf.__file__, pcdnf.__version__)")
    assert done.stdout.split() == [str(next(environment.rglob("pcdnf/__init__.py"))), __version__], done.stderr
    assert run(environment, tmp_path, "python", "-c", "import service").returncode == 1


@pytest.mark.timeout(600)
def test_the_installed_wheel_denoises(environment: Path, tmp_path: Path) -> None:
    write(tmp_path / "noisy.ply", PointCloud(points=sphere(COUNT)))
    done = run(environment, tmp_path, "pcdnf", "denoise", "noisy.ply", "-o", "clean.ply")
    assert done.returncode == 0, done.stderr
    before, after = (
        np.abs(np.linalg.norm(read(tmp_path / name).points, axis=1) - 1).mean() for name in ("noisy.ply", "clean.ply")
    )
    assert after < 0.8 * before


@pytest.mark.parametrize("words", [["serve", "--port", "0"], ["drain", "--status"], ["doctor"]])
def test_commands_of_the_service_say_where_it_is(words: list[str], environment: Path, tmp_path: Path) -> None:
    done = run(environment, tmp_path, "pcdnf", *words)
    assert done.returncode == 2
    assert done.stderr == (
        "pcdnf: The REST service is not part of the installed package. "
        "Run scripts/serve in a clone of the repository, or the container image.\n"
    )
