from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from service.jobs import drain_switch
from service.operations.doctor import Finding, examine
from service.settings import Settings
from tests.support.board import Board
from tests.support.service_process import Service

COMMAND = """
from argparse import ArgumentParser
from service.cli import add_doctor
parser = ArgumentParser()
add_doctor(parser.add_subparsers())
arguments = parser.parse_args()
raise SystemExit(arguments.run(arguments))
"""


def _found(settings: Settings) -> dict[str, list[Finding]]:
    found: dict[str, list[Finding]] = {}
    for finding in examine(settings):
        found.setdefault(finding.about, []).append(finding)
        assert finding.text
        assert finding.level == "ok" or finding.advice
    return found


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port: int = listener.getsockname()[1]
        return port


def _command(*options: str, **settings: str) -> subprocess.CompletedProcess[str]:
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PCDNF_")}
    environment |= {f"PCDNF_{key.upper()}": value for key, value in settings.items()}
    return subprocess.run(
        [sys.executable, "-c", COMMAND, "doctor", *options],
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
    )


def test_before_the_first_start_all_is_well_and_nothing_is_made(tmp_path: Path) -> None:
    found = _found(Settings(data_dir=tmp_path / "data", port=_free_port()))
    assert {finding.level for findings in found.values() for finding in findings} == {"ok"}
    assert {"python", "torch", "device", "weights", "formats", "data", "disk", "database", "keys", "port"} <= set(found)
    assert list(tmp_path.iterdir()) == []


def test_a_running_service(running: Service) -> None:
    port = running.client.base_url.port
    assert port is not None
    found = _found(Settings(data_dir=running.data, port=port))
    assert found["service"][0].level == "ok"
    assert "1 workers" in found["service"][0].text
    assert found["database"][0].level == found["storage"][0].level == "ok"


def test_a_service_without_a_worker_and_drained(make_served: Any, board: Board) -> None:
    with board.engine.begin() as connection:
        drain_switch.set_switch(connection, drain_switch.DRAIN, on=True)
    found = _found(Settings(data_dir=board.settings.data_dir, port=make_served().address[1]))
    assert found["service"][0].level == "problem"
    assert "No worker is running." in found["service"][0].text
    assert found["drain"][0].level == "warning"
    assert "--off" in (found["drain"][0].advice or "")


@pytest.mark.parametrize(
    ("settings", "about", "words"),
    [
        ({"device": "cuda:99"}, "device", "cuda:99"),
        ({"default_model": "nothing"}, "weights", "'nothing'"),
        ({"min_free_bytes": 10**18}, "disk", "must stay free"),
        ({"host": "0.0.0.0"}, "keys", "without a key"),
        ({"api_keys_file": "/nothing/keys"}, "keys", "cannot be used"),
        ({"database_url": "postgresql://ada:secret@127.0.0.1:1/x"}, "database", "does not answer"),
        ({"data_dir": "/proc/nothing"}, "data", "not writable"),
        ({"storage_url": "s3://bucket"}, "storage", "cannot be used"),
    ],
)
def test_problems(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, settings: dict[str, object], about: str, words: str
) -> None:
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:1")
    found = _found(Settings(**{"data_dir": tmp_path / "data", "port": _free_port()} | settings))  # type: ignore[arg-type]
    problem = next(finding for finding in found[about] if finding.level == "problem")
    assert words in problem.text
    assert "secret" not in str(found)


def test_a_port_that_another_program_holds(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        other.settimeout(20)
        port = other.getsockname()[1]
        found = _found(Settings(data_dir=tmp_path, port=port))  # it listens and never answers
    assert found["port"][0].level == "problem"
    assert str(port) in found["port"][0].text


def test_a_database_of_an_older_version_is_left_as_it_is(board: Board) -> None:
    with board.engine.begin() as connection:
        connection.execute(sa.text("ALTER TABLE pcdnf_workers DROP COLUMN metrics"))
    found = _found(Settings(data_dir=board.settings.data_dir, port=_free_port()))
    assert found["database"][0].level == "warning"
    assert "pcdnf_workers.metrics" in found["database"][0].text
    assert "metrics" not in {column["name"] for column in sa.inspect(board.engine).get_columns("pcdnf_workers")}


def test_the_command_counts_problems(tmp_path: Path) -> None:
    good = _command("--data-dir", str(tmp_path), port=str(_free_port()))
    assert (good.returncode, good.stderr) == (0, "")
    assert good.stdout.startswith("ok       python   Python 3.")
    bad = _command("--json", data_dir=str(tmp_path), port=str(_free_port()), default_model="nothing")
    assert bad.returncode == 1
    levels = {finding["level"] for finding in json.loads(bad.stdout)}
    assert levels == {"ok", "problem"}
