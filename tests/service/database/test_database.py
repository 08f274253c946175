from __future__ import annotations

import socket
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import pytest
import sqlalchemy as sa

from service.api.app import LOCK_SECONDS
from service.database.engine import CONNECTION, create_engine
from service.database.migrations import migrate
from service.database.tables import jobs as jobs_table
from service.database.tables import now_ms
from service.database.tables import outcomes as outcomes_table
from service.database.tables import workers as workers_table
from service.settings import Settings
from tests.support.board import MakeApi


def test_processes_may_migrate_at_once(tmp_path: Path) -> None:
    code = "from service.database.migrations import migrate; from service.settings import Settings; migrate(Settings())"
    environment = {"PCDNF_DATA_DIR": str(tmp_path)}
    processes = [subprocess.Popen([sys.executable, "-c", code], env=environment) for _ in range(3)]
    assert [process.wait(60) for process in processes] == [0, 0, 0]
    engine = create_engine(Settings(data_dir=tmp_path))
    names = sa.inspect(engine).get_table_names()
    engine.dispose()
    assert {"pcdnf_jobs", "pcdnf_workers", "workflow_status"} <= set(names)


def test_sqlite_is_durable_and_waits_for_its_turn(tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path)
    migrate(settings)
    engine = create_engine(settings)
    with engine.connect() as connection:
        pragmas = {
            name: connection.execute(sa.text(f"PRAGMA {name}")).scalar()
            for name in ("journal_mode", "synchronous", "busy_timeout", "foreign_keys")
        }
        now = connection.execute(sa.select(now_ms())).scalar_one()
    engine.dispose()
    assert pragmas == {"journal_mode": "wal", "synchronous": 2, "busy_timeout": 30_000, "foreign_keys": 1}
    assert abs(now - time.time() * 1000) < 2000


def test_a_caller_waits_no_longer_for_a_lock_than_it_is_told(make_api: MakeApi, tmp_path: Path) -> None:
    client = make_api()
    other = sqlite3.connect(tmp_path / "data" / "pcdnf.sqlite", isolation_level=None)
    other.execute("BEGIN EXCLUSIVE")
    began = time.monotonic()
    answer = client.post(
        "/denoise", content=b"ply", headers={"Content-Type": "application/ply", "Idempotency-Key": "a"}
    )
    assert time.monotonic() - began < LOCK_SECONDS + 1
    assert (answer.status_code, answer.json()["code"]) == (503, "database_unavailable")
    assert "another program" in answer.json()["detail"]
    assert int(answer.headers["retry-after"]) > 0
    assert client.get("/jobs").status_code == 200  # reading goes on
    other.execute("ROLLBACK")
    other.close()


def test_an_older_database_gets_the_columns_it_lacks(tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path)
    migrate(settings)
    engine = create_engine(settings)
    with engine.begin() as connection:
        connection.execute(
            sa.text("INSERT INTO pcdnf_workers (id, pid, state, details, beat_at) VALUES ('a',1,'',1,1)")
        )
        for table, column in (("pcdnf_jobs", "context"), ("pcdnf_workers", "metrics")):
            connection.execute(sa.text(f"ALTER TABLE {table} DROP COLUMN {column}"))
        connection.execute(sa.text("DROP TABLE pcdnf_outcomes"))
    for _ in range(2):
        migrate(settings)
    with engine.connect() as connection:
        assert connection.execute(sa.select(workers_table.c.id, workers_table.c.metrics)).all() == [("a", None)]
        assert connection.execute(sa.select(jobs_table)).all() == []
        assert connection.execute(sa.select(outcomes_table)).all() == []
    engine.dispose()


def test_a_server_that_does_not_answer_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(CONNECTION, "connect_timeout", 2)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        url = f"postgresql://a:b@127.0.0.1:{silent.getsockname()[1]}/c"
        engine = create_engine(Settings(data_dir=tmp_path, database_url=url))
        began = time.monotonic()
        with pytest.raises(sa.exc.OperationalError, match="timeout"):
            engine.connect()
        assert time.monotonic() - began < 20
        engine.dispose()


def test_the_clock_on_postgresql() -> None:
    from sqlalchemy.dialects import postgresql

    compiled = str(sa.select(now_ms()).compile(dialect=postgresql.dialect()))
    assert "clock_timestamp()" in compiled
