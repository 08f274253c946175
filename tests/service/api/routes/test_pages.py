from __future__ import annotations

import json
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import httpx
import pytest

from pcdnf.file_formats import FORMATS
from service.api.middleware.guard import POLICY
from service.api.routes.pages import DOCS_POLICY, FOLDER

ROOT = Path(__file__).parents[4]


@pytest.mark.parametrize(
    "path", ["/", "/livez", "/jobs", "/jobs/unknown", "/nothing", "/viewer/app.js", "/viewer/none"]
)
def test_every_response_has_the_policy(api: httpx.Client, path: str) -> None:
    headers = api.get(path).headers
    assert headers["content-security-policy"] == POLICY
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["referrer-policy"] == "same-origin"
    assert "set-cookie" not in headers
    assert POLICY.startswith("default-src 'self'; ")
    assert "unsafe" not in DOCS_POLICY


class _Loaded(HTMLParser):
    """What a page loads, and what the policy would refuse."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.loads: list[str] = []
        self.refused: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if tag == "script" and "src" not in given:
            self.refused.append("inline script")
        self.refused += [name for name in given if name.startswith("on") or name == "style"]
        if tag in ("script", "img", "link") and given.get("rel") != "expect":  # which names a part of the page
            self.loads.append(given.get("src") or given.get("href") or "")


@pytest.mark.parametrize("page", ["/", "/docs"])
def test_pages_load_only_what_the_service_has(api: httpx.Client, page: str) -> None:
    response = api.get(page)
    assert response.headers["content-type"].startswith("text/html")
    assert response.headers["cache-control"] == "no-cache"
    found = _Loaded(response.text)
    assert found.refused == []
    assert found.loads
    for path in found.loads:
        assert "//" not in path
        file = api.get(f"/{path}")
        assert file.status_code == 200, path
        assert api.get(f"/{path}", headers={"If-None-Match": file.headers["etag"]}).status_code == 304
    assert api.head(page).status_code == 200


def test_modules_import_what_is_there() -> None:
    modules = [path for path in FOLDER.glob("*.js") if path.name not in ("theme.js", "docs.js")]
    assert len(modules) > 5
    for module in modules:
        for name in re.findall(r'from "(.*?)"', module.read_text()):
            assert (FOLDER / name).is_file(), f"{module.name}: {name}"


def test_the_page_names_every_format_that_needs_no_library(api: httpx.Client) -> None:
    page = api.get("/").text
    always = {name: known.title for name, known in FORMATS.items() if not known.library}
    assert re.findall(r'<option value="(.*?)">(.*?)</option>', page) == list(always.items())
    *titles, last = always.values()
    assert f">{', '.join(titles)} or {last}<" in page


def test_the_sample_is_that_of_the_examples(api: httpx.Client) -> None:
    assert api.get("/viewer/sample.ply").content == (ROOT / "examples" / "bracket_noisy.ply").read_bytes()


def test_vendored_files_name_the_pinned_versions() -> None:
    locked = json.loads((ROOT / "package-lock.json").read_text())["packages"]
    for name, version in json.loads((ROOT / "package.json").read_text())["devDependencies"].items():
        assert locked[f"node_modules/{name}"]["version"] == version
        assert locked[f"node_modules/{name}"]["integrity"].startswith("sha512-")
    revision = locked["node_modules/three"]["version"].split(".")[1]
    assert re.search(rf'["`]{revision}["`]', (FOLDER / "vendor" / "three.js").read_text())


@pytest.mark.full
def test_vendored_files_are_what_npm_has(tmp_path: Path) -> None:
    if shutil.which("npm") is None:
        pytest.skip("npm is not installed")
    made = subprocess.run([ROOT / "scripts" / "vendor", tmp_path], capture_output=True, text=True, timeout=200)
    if re.search("ENOTFOUND|ECONNREFUSED|ETIMEDOUT|EAI_AGAIN|ENOTCACHED", made.stderr):
        pytest.skip("the npm registry cannot be reached")
    assert made.returncode == 0, made.stderr
    kept = {path.name: path.read_bytes() for path in (FOLDER / "vendor").iterdir() if path.name != "three.entry.js"}
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == kept
