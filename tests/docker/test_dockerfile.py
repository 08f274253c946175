"""The instructions of the Dockerfile, followed by hand: what they copy is there, and the result runs the service.

No engine builds an image here. The stages `wheel` and `cpu` are carried out in folders: their files are copied, the
wheel is built, and `docker/install-package` installs it into a virtual environment without this repository.
"""

from __future__ import annotations

import fnmatch
import os
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[2]
DOCKER = ROOT / "docker"
BUILD = "import sys; from setuptools import build_meta; build_meta.build_wheel(sys.argv[1])"
LAST_STAGES = ("cpu", "cuda")


@dataclass(frozen=True)
class Instruction:
    stage: str
    word: str
    arguments: tuple[str, ...]


def instructions() -> Iterator[Instruction]:
    stage = ""
    lines = [line for line in (DOCKER / "Dockerfile").read_text().splitlines() if not line.startswith("#")]
    for line in "\n".join(lines).replace("\\\n", " ").splitlines():
        word, *arguments = line.split() or [""]
        if word == "FROM":
            stage = arguments[arguments.index("AS") + 1]
        if word:
            yield Instruction(stage, word, tuple(arguments))


def copies(stage: str) -> list[tuple[list[str], str]]:
    """The sources and the target of each COPY from the context in a stage."""
    found = [each.arguments for each in instructions() if each.stage == stage and each.word == "COPY"]
    return [(list(words[:-1]), words[-1]) for words in found if not words[0].startswith("--")]


def context() -> list[str]:
    """The files that git knows or would add and that `.dockerignore` lets into the build."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    ).stdout.split("\0")
    rules = [line for line in (ROOT / ".dockerignore").read_text().splitlines() if line and line[0] != "#"]

    def enters(name: str) -> bool:
        inside = True
        for rule in rules:
            pattern = rule.removeprefix("!").removeprefix("**/")
            if fnmatch.fnmatch(name, pattern) or fnmatch.fnmatch(name, f"{pattern}/*"):
                inside = rule.startswith("!")
        return inside

    return [name for name in listed if name and (ROOT / name).is_file() and enters(name)]


def carry_out(stage: str, root: Path, workdir: str) -> None:
    """Copy what a stage copies from the context into `root`."""
    files = context()
    for sources, target in copies(stage):
        destination = root / (Path(workdir) / target).relative_to("/")
        into = len(sources) > 1 or target.endswith("/")
        for source in sources:
            inside = [name for name in files if name == source or name.startswith(f"{source}/")]
            assert inside, f"{source} is not in the build context"
            place = destination / Path(source).name if into and inside == [source] else destination
            for name in inside:
                copy = place / Path(name).relative_to(source)
                copy.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(ROOT / name, copy)


def without_python_settings() -> dict[str, str]:
    return {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "PCDNF_", "NUMBA_"))}


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The virtual environment of the image, with this environment's libraries in place of those of the index."""
    root = tmp_path_factory.mktemp("image")
    carry_out("builder", root, "/src")
    carry_out("wheel", root, "/src")
    subprocess.run([sys.executable, "-c", BUILD, root / "wheel"], cwd=root / "src", check=True, capture_output=True)

    home = root / "opt/pcdnf"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", home], check=True)
    packages = next((home / "lib").glob("python3*/site-packages"))
    # Paths named in a .pth file are searched, but the .pth files in them are not read: this repository stays out.
    (packages / "libraries.pth").write_text(sysconfig.get_path("purelib") + "\n")

    carry_out("runtime", root, "/data")
    programs = root / "usr/local/bin"
    (programs / "python3").symlink_to(sys.executable)  # the base's Python, which has pip
    (root / "wheel/warm_up.py").write_text("")  # compiling all kernels takes minutes
    script = root / "wheel/install-package"
    script.write_text(script.read_text().replace("/opt/pcdnf", str(home)))
    environment = without_python_settings() | {"PATH": f"{programs}:/usr/bin:/bin"}
    done = subprocess.run([script], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert not script.parent.exists()
    return home


def commands() -> list[tuple[str, ...]]:
    """The commands that the Dockerfile and the compose files give to the image."""
    found = {("pcdnf", "serve")}
    for path in ROOT.glob("docker-compose*.yml"):
        services = yaml.safe_load(path.read_text())["services"].values()
        found |= {tuple(each["command"]) for each in services if isinstance(each.get("command"), list)}
    return sorted(command for command in found if command[0] in ("pcdnf", "python"))


def test_the_end_of_every_build_is_the_service_in_its_place() -> None:
    for stage in LAST_STAGES:
        (install,) = [each.arguments for each in instructions() if (each.stage, each.word) == (stage, "RUN")]
        copied = [each.arguments for each in instructions() if (each.stage, each.word) == (stage, "COPY")]
        assert install == ("/build/install-package",)
        assert ("--from=wheel", "/wheel", "/build") in copied
    assert copies("wheel")[-2:] == [
        (["service"], "/wheel/service"),
        (["docker/install-package", "docker/warm_up.py"], "/wheel/"),
    ]


def test_the_image_imports_what_its_commands_start(image: Path, tmp_path: Path) -> None:
    modules = [command[2] for command in commands() if command[:2] == ("python", "-m")]
    assert {"service.api", "service.worker"} <= set(modules)
    modules += ["service.cli", "service.api.server", "service.worker.main", "service.operations.supervisor"]
    code = f"import importlib\nfor name in {sorted(modules)}: print(importlib.import_module(name).__file__)"
    done = subprocess.run(
        [image / "bin/python", "-c", code], cwd=tmp_path, env=without_python_settings(), capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert [line for line in done.stdout.splitlines() if not line.startswith(f"{image}/")] == []


def test_the_image_starts_its_command(image: Path, tmp_path: Path) -> None:
    done = subprocess.run(
        [image / "bin/pcdnf", "serve", "--help"],
        cwd=tmp_path,
        env=without_python_settings(),
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert "--data-dir" in done.stdout


def test_the_image_has_the_files_of_the_page_and_the_weights(image: Path) -> None:
    packages = next((image / "lib").glob("python3*/site-packages"))
    data = [name for name in context() if name.startswith(("service/", "pcdnf/weights/")) and not name.endswith(".py")]
    assert len(data) > 10
    assert [name for name in data if not (packages / name).is_file()] == []
