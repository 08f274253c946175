"""The documentation builds into a site without a warning, and the site asks no other server for anything."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted(path.name for path in (ROOT / "docs").glob("*.md"))


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("mkdocs", reason="the extra docs is not installed")
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)],
        cwd=ROOT,
        env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def test_every_page_is_in_the_site(site: Path) -> None:
    assert "index.md" in PAGES
    assert [page for page in PAGES if not (site / page).with_suffix(".html").is_file()] == []


def test_it_works_without_the_internet(site: Path) -> None:
    loaded = re.compile(
        r"""<(?:script|img|iframe)[^>]*\ssrc=["']?https?:|<link[^>]*(?:stylesheet|preconnect)[^>]*https?:"""
    )
    assert [path.name for path in site.rglob("*.html") if loaded.search(path.read_text())] == []


def test_pictures_are_small() -> None:
    pictures = [path for path in (ROOT / "docs/images").iterdir() if path.name != "bracket.png"]  # that one is README's
    assert pictures
    assert [path.name for path in pictures if path.stat().st_size > 300_000] == []


def test_a_new_user_finds_every_page() -> None:
    nav = yaml.safe_load((ROOT / "mkdocs.yml").read_text())["nav"]
    listed = [page for entry in nav for page in ([entry] if isinstance(entry, str) else next(iter(entry.values())))]
    assert sorted(listed) == PAGES
    assert listed[:2] == ["index.md", "tutorial.md"]
