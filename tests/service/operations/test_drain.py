from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import sqlalchemy as sa

from service.database.engine import create_engine
from service.database.migrations import lacking
from service.operations.drain import drain
from service.settings import Settings, SettingsError
from service.supervision import EX_CONFIG
from tests.support.board import Board
from tests.support.service_process import Service, write_sphere

COMMAND = """
from argparse import ArgumentParser
from service.cli import add_drain
parser = ArgumentParser()
add_drain(parser.add_subparsers())
arguments = parser.parse_args()
raise SystemExit(arguments.run(arguments))
"""


def _drain(data: Path, *options: str) -> subprocess.CompletedProcess[str]:
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PCDNF_")}
    return subprocess.run(
        [sys.executable, "-c", COMMAND, "drain", "--data-dir", str(data), *options],
        env=environment, capture_output=True, text=True, timeout=120,
    )  # fmt: skip


def test_nothing_is_made_where_no_service_was(tmp_path: Path) -> None:
    ended = _drain(tmp_path / "nothing")
    assert ended.returncode == EX_CONFIG
    assert "PCDNF_DATA_DIR" in ended.stderr
    assert not (tmp_path / "nothing").exists()
    with pytest.raises(SettingsError, match="does not answer"):
        drain(Settings(data_dir=tmp_path, database_url="postgresql://a:b@127.0.0.1:1/c"), on=True, wait=False)


def test_to_look_changes_no_older_or_empty_database(tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path)
    (tmp_path / "pcdnf.sqlite").touch()
    with pytest.raises(SettingsError, match="no pcdnf_"):
        drain(settings, on=None, wait=False)
    assert not (tmp_path / "pcdnf.sqlite").stat().st_size
    drain(settings, on=True, wait=False)
    engine = create_engine(settings)
    with engine.begin() as connection:
        connection.execute(sa.text("ALTER TABLE pcdnf_workers DROP COLUMN metrics"))
    with pytest.raises(SettingsError, match=r"no pcdnf_workers\.metrics"):
        drain(settings, on=None, wait=False)
    assert lacking(engine) == "pcdnf_workers.metrics"
    drain(settings, on=False, wait=False)
    assert lacking(engine) is None
    engine.dispose()


def test_it_says_what_is_left_and_who_works(board: Board, capsys: pytest.CaptureFixture[str]) -> None:
    board.submit(points=100, iterations=2)
    drain(board.settings, on=None, wait=False)
    drain(board.settings, on=True, wait=False)
    board.workers.beat("a", pid=1, state="ready", details={})
    drain(board.settings, on=None, wait=False)
    drain(board.settings, on=False, wait=False)
    left = "Unfinished jobs: 1, with 200 points times passes."
    assert capsys.readouterr().out.splitlines() == [
        f"Open: new jobs are accepted. {left} No worker is running, so they wait.",
        f"Draining: new jobs are refused. {left} No worker is running, so they wait.",
        f"Draining: new jobs are refused. {left}",
        f"Open: new jobs are accepted. {left}",
    ]


def test_drained_worked_off_and_opened_again(running: Service, small: Path, tmp_path: Path) -> None:
    job = running.submit(write_sphere(tmp_path / "large.ply", 5000))
    try:
        ended = _drain(running.data, "--wait")
        assert ended.returncode == 0, ended.stderr
        assert ended.stdout.splitlines()[-1] == "Draining: new jobs are refused. All jobs are finished."
        assert running.job(job["id"])["status"] == "succeeded"
        refused = running.client.post("/denoise", files={"file": small.read_bytes()})
        assert (refused.status_code, refused.json()["code"]) == (503, "draining")
        assert running.client.get("/readyz").status_code == 503
    finally:
        assert _drain(running.data, "--off").returncode == 0
    assert running.client.get("/readyz").status_code == 200
    running.wait_status(running.submit(small)["id"], "succeeded")
