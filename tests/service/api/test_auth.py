from __future__ import annotations

import hashlib
import logging
import os
from pathlib import Path

import pytest

from service.api.auth import Keys
from service.settings import SettingsError
from tests.support.board import MakeApi


def _line(name: str, key: str) -> str:
    return f"{name}:{hashlib.sha256(key.encode()).hexdigest()}\n"


def test_keys_of_a_file_and_of_the_settings(tmp_path: Path) -> None:
    path = tmp_path / "keys"
    path.write_text("# people\n\n" + _line("ada", "ada's key") + _line("bob", "bob's key").strip() + "  # on leave\n")
    keys = Keys("a single key", path)
    assert keys.required
    assert keys.owner("ada's key") == "ada"
    assert keys.owner("bob's key") == "bob"
    assert keys.owner("a single key") == "default"
    assert keys.owner("ada's kez") is None
    assert keys.owner("\udcff") is None
    assert not Keys(None, None).required


def test_the_file_is_read_again_when_it_changes(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "keys"
    path.write_text(_line("ada", "first"))
    keys = Keys(None, path)
    path.write_text(_line("ada", "second"))
    os.utime(path, ns=(1, 1))
    assert keys.owner("first") is None
    assert keys.owner("second") == "ada"
    caplog.set_level(logging.WARNING, "service.api.auth")
    for number, broken in enumerate((b"nonsense\n", b"ada:\xff\n"), 2):
        path.write_bytes(broken)
        os.utime(path, ns=(number, number))
        for _ in range(3):
            assert keys.owner("second") == "ada"  # a file broken while running does not lock everybody out
    path.unlink()
    for _ in range(3):
        assert keys.owner("second") == "ada"
    said = [record.getMessage().partition(": ")[2] for record in caplog.records]  # once of each
    assert said[:2] == ["line 1 is not `name:sha256-in-hex`", "it is not UTF-8 text"]
    assert len(said) == 3
    assert "No such file" in said[2]
    path.write_text(_line("ada", "third"))
    assert keys.owner("third") == "ada"


@pytest.mark.parametrize("text", ["ada\n", "ada:1234\n", "a b:" + "0" * 64 + "\n", "\udcff\n", None])
def test_a_bad_file_is_refused_at_start(tmp_path: Path, text: str | None) -> None:
    path = tmp_path / "keys"
    if text is not None:
        path.write_text(text, errors="surrogateescape")
    with pytest.raises(SettingsError, match="PCDNF_API_KEYS_FILE"):
        Keys(None, path)


def test_routes_ask_for_the_key_and_probes_do_not(make_api: MakeApi) -> None:
    api = make_api(host="0.0.0.0", api_key="correct horse battery")
    for method, path in [("POST", "/denoise"), ("GET", "/jobs"), ("GET", "/jobs/1"), ("DELETE", "/jobs/1"),
                         ("GET", "/jobs/1/result"), ("GET", "/models")]:  # fmt: skip
        for headers in ({}, {"Authorization": "Bearer wrong"}, {"Authorization": "Basic correct horse battery"}):
            response = api.request(method, path, headers=headers)
            assert (response.status_code, response.json()["code"]) == (401, "not_authenticated"), path
            assert response.headers["www-authenticate"] == "Bearer"
    assert api.get("/jobs", headers={"Authorization": "Bearer correct horse battery"}).json() == []
    assert api.get("/livez").status_code == 200
    assert api.get("/readyz").json()["code"] == "not_ready"


def test_a_job_is_visible_to_its_key_alone(make_api: MakeApi, tmp_path: Path, small: Path) -> None:
    path = tmp_path / "keys"
    path.write_text(_line("ada", "ada's key") + _line("bob", "bob's key"))
    api = make_api(api_keys_file=path)
    ada, bob = ({"Authorization": f"Bearer {name}'s key"} for name in ("ada", "bob"))
    job = api.post("/denoise", files={"file": small.read_bytes()}, headers=ada).json()
    for method, suffix in [("GET", ""), ("DELETE", ""), ("GET", "/result")]:
        response = api.request(method, f"/jobs/{job['id']}{suffix}", headers=bob)
        assert (response.status_code, response.json()["code"]) == (404, "job_not_found")
    assert api.get("/jobs", headers=bob).json() == []
    assert [seen["id"] for seen in api.get("/jobs", headers=ada).json()] == [job["id"]]
    assert api.get(f"/jobs/{job['id']}", headers=ada).json()["status"] == "queued"
