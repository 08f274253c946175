"""Every command and code block of the documentation does what it is there for.

A page is worked through from top to bottom in a folder of its own, where small clouds stand in for the samples and for
the reader's ``scan.ply``, beside a running service. ``<!-- long: why -->`` before a block says that it takes too
long or needs what is not there: of such a block every command, option and file it names must exist.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import pytest
import yaml

from pcdnf.cli.main import build_parser
from service.settings import Settings
from tests.support.clouds import thinned_examples
from tests.support.service_process import Service

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted((ROOT / "docs").glob("*.md"))
ADDRESS = "http://127.0.0.1:8000"
SECONDS = 240
POINTS = 1000
FENCED = re.compile(r"^(?:<!-- long: (?P<long>[^\n]+) -->\n)?```(?P<kind>\w*)\n(?P<text>.*?)^```$", re.M | re.S)
SHELL = """set -euo pipefail; set -a; [ ! -e .variables ] || . ./.variables
trap 'export -p > .variables' EXIT
"""


@dataclass(frozen=True)
class Block:
    kind: str
    text: str
    long: str | None


def blocks(page: Path) -> list[Block]:
    return [Block(found["kind"], found["text"], found["long"]) for found in FENCED.finditer(page.read_text())]


def with_code(*kinds: str, long: bool = False) -> list[object]:
    """The pages that have such blocks."""
    wanted = [page for page in PAGES if any(b.kind in kinds and bool(b.long) == long for b in blocks(page))]
    return [pytest.param(page, id=page.name) for page in wanted]


@pytest.fixture(scope="module")
def samples(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The clouds of ``examples/``, thinned."""
    return thinned_examples(tmp_path_factory.mktemp("samples"), POINTS)


@pytest.fixture
def folder(tmp_path: Path, samples: Path, running: Service) -> Path:
    """Where a page is worked through."""
    (tmp_path / "data").symlink_to(running.data)
    (tmp_path / "examples").symlink_to(samples)
    (tmp_path / "scans").mkdir()
    for name in ("scan.ply", "scans/first.ply", "scans/second.ply"):
        (tmp_path / name).write_bytes((samples / "scan_boxes.ply").read_bytes())
    return tmp_path


@pytest.mark.full
@pytest.mark.parametrize("page", with_code("sh", "python"))
def test_blocks_run(page: Path, folder: Path, url: str) -> None:
    more = {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}", "PCDNF_URL": url}
    for block in blocks(page):
        if block.long or block.kind not in ("sh", "python"):
            continue
        text = block.text.replace(ADDRESS, url)
        command = [sys.executable, "-c", text] if block.kind == "python" else ["bash", "-c", SHELL + text]
        done = subprocess.run(
            command, cwd=folder, env=os.environ | more, capture_output=True, text=True, timeout=SECONDS
        )
        assert done.returncode == 0, f"{block.text}\n{done.stdout}{done.stderr}"


@pytest.mark.parametrize("page", with_code("json"))
def test_json_is_json(page: Path) -> None:
    for block in blocks(page):
        if block.kind == "json":
            json.loads(block.text)


@pytest.mark.parametrize("page", with_code("sh", long=True))
def test_long_blocks_name_what_exists(page: Path) -> None:
    for block in blocks(page):
        for line in block.text.replace("\\\n", " ").splitlines() if block.long else ():
            words = shlex.split(line, comments=True)
            while words and re.fullmatch(r"[A-Z_]+=\S*", words[0]):
                words.pop(0)
            if words:
                check(words)


def check(words: list[str]) -> None:
    """That a command and what it names exist."""
    program, *rest = words
    if program == "pcdnf":
        build_parser(command=rest[0]).parse_args(rest)
    elif program.startswith("scripts/"):
        assert os.access(ROOT / program, os.X_OK), program
    elif program == "export":
        named = [word.partition("=")[0].removeprefix("PCDNF_").lower() for word in rest if word.startswith("PCDNF_")]
        assert [name for name in named if name not in Settings.model_fields] == []
    elif words[:2] == ["python", "-m"]:
        assert find_spec(rest[1]) is not None, rest[1]
    elif program == "python":
        source = (ROOT / rest[0]).read_text()
        options = [word.partition("=")[0] for word in rest if word.startswith("--")]
        assert [option for option in options if f'"{option}"' not in source] == []
    elif words[:2] == ["pip", "install"]:
        extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
        named = re.findall(r"(?:\.|pcdnf)\[([\w,]+)\]", " ".join(rest))
        assert named or "." in rest, words
        assert [name for group in named for name in group.split(",") if name not in extras] == []
    elif words[:2] == ["docker", "compose"]:
        check_compose(rest[1:])
    else:
        assert words[:2] == ["docker", "run"], f"teach this test to check {words}"


def check_compose(words: list[str]) -> None:
    """That files, profiles and services exist."""
    files = [words[i + 1] for i, word in enumerate(words) if word == "-f"] or ["docker-compose.yml"]
    known: dict[str, object] = {}
    profiles = set()
    for name in files:
        text = re.sub(r"!(reset|override)\b", "", (ROOT / name).read_text())
        for service, facts in yaml.safe_load(text)["services"].items():
            known[service] = facts
            profiles |= set(facts.get("profiles") or ())
    asked = [words[i + 1] for i, word in enumerate(words) if word == "--profile"]
    assert set(asked) <= profiles
    verb = next(i for i, word in enumerate(words) if word in ("up", "down", "stop", "logs", "pull", "build"))
    assert {word.partition("=")[0] for word in words[verb + 1 :] if not word.startswith("-")} <= set(known)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_no_block_escapes(page: Path) -> None:
    text = page.read_text()
    found = blocks(page)
    assert len(re.findall(r"^ *```", text, re.M)) == 2 * len(found), "a block that is not fenced as the others are"
    assert {block.kind for block in found} <= {"sh", "python", "json", "text"}
    assert not [block.text for block in found if block.long and block.kind != "sh"]
    assert re.findall(r"\n\n(    \S.*)", FENCED.sub("", text)) == [], "write commands in fenced blocks"


def test_every_test_that_the_page_on_security_names_exists() -> None:
    rows = [line for line in (ROOT / "docs/security.md").read_text().splitlines() if line.startswith("|")]
    missing, named = [], 0
    for row in rows:
        files: list[Path] = []
        for reference in re.findall(r"`(.*?)`", row.split("|")[-2]):
            path, _, name = reference.partition("::") if ".py" in reference else ("", "", reference)
            if path:
                files = [ROOT / path] if "/" in path else list((ROOT / "tests").rglob(path))
            named += 1
            if not any(file.is_file() and (not name or f"def {name}(" in file.read_text()) for file in files):
                missing.append(reference)
    assert missing == []
    assert named > 50
