"""The same service on PostgreSQL."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import sqlalchemy as sa

from service.api.intake.idempotency import Claims
from service.api.metrics import Deployment
from service.database.engine import CONNECTION, create_engine
from service.database.migrations import migrate
from service.jobs import drain_switch
from service.operations.drain import drain
from service.problems import Problem
from service.settings import Settings
from service.worker.metrics import WorkerMetrics
from tests.support.board import open_board, submit_at_once
from tests.support.servers import database, postgresql
from tests.support.service_process import Service, write_sphere


@pytest.fixture(scope="module")
def postgresql_url() -> Iterator[str]:
    """A PostgreSQL server."""
    with postgresql() as url:
        yield url


@pytest.fixture
def database_url(postgresql_url: str) -> Iterator[str]:
    """A database of its own."""
    with database(postgresql_url) as url:
        yield url


def test_the_queue_is_bounded_exactly(database_url: str, tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path, database_url=database_url, max_queued_points=1000, max_caller_points=1000)
    with open_board(settings) as board:
        accepted, refused = submit_at_once(board, 30, points=99)
        assert (len(accepted), refused) == (10, ["queue_full"] * 20)
        claim = Claims(board.engine).claim("ada", "key")
        with board.engine.begin() as connection:
            Claims.bind(connection, claim, accepted[0].id, "f")
        assert Claims(board.engine).claim("ada", "key").job == accepted[0].id
        board.jobs.cancel(accepted[0])
        board.jobs.remove(accepted[0])
        assert Claims(board.engine).claim("ada", "key").job is None


def test_upgrade_outcomes_switches_and_metrics(database_url: str, tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path, database_url=database_url)
    with open_board(settings) as board:
        with board.engine.begin() as connection:
            connection.execute(sa.text("ALTER TABLE pcdnf_workers DROP COLUMN metrics"))
        migrate(settings)
        fails, queued, waits = board.submit(), board.submit(), board.submit(points=30)
        board.attempts.acquire(fails.id)
        assert board.attempts.fail(fails.id, {"code": "worker_lost"})
        board.jobs.cancel(queued)
        board.workers.beat("a", pid=1, state="ready", details={}, metrics=WorkerMetrics().text("cpu"))
        drain(settings, on=True, wait=False)
        with pytest.raises(Problem, match="takes no new ones"):
            board.submit()
        found = {
            (sample.name, *sorted(sample.labels.values())): sample.value
            for family in Deployment(board.engine, board.storage, settings).collect()
            for sample in family.samples
        }
        assert found["pcdnf_jobs_finished_total", "failed", "worker_lost"] == 1
        assert found["pcdnf_jobs_finished_total", "", "cancelled"] == 1
        assert found["pcdnf_unfinished_points", "queued"] == waits.total == 30
        assert found["pcdnf_oldest_queued_job_age_seconds",] >= 0
        assert found["pcdnf_draining",] == found["pcdnf_database_up",] == found["pcdnf_workers", "ready"] == 1
        assert found["pcdnf_stage_duration_seconds_count", "a", "tile"] == 0
        drain(settings, on=False, wait=False)
        board.submit()


def test_submit_resume_cancel_remove(database_url: str, tmp_path: Path) -> None:
    service = Service(tmp_path / "service", database_url=database_url, tile_points=512).start()
    path = write_sphere(tmp_path / "a.ply", 5000)
    job = service.submit(path)["id"]
    service.wait_done(job, 1024)  # so that the checkpoint of the first tile is written
    worker = service.child("service.worker")
    os.kill(worker, signal.SIGKILL)
    queued = service.submit(path)["id"]
    assert service.client.delete(f"/jobs/{queued}").json()["status"] == "cancelled"
    assert service.wait_status(job, "succeeded", "failed")["status"] == "succeeded"
    assert service.output().count(f"job {job} iteration 0 tile 0-512 done") == 1
    assert service.client.get(f"/jobs/{job}/result").status_code == 200
    assert service.client.delete(f"/jobs/{job}").status_code == 204
    assert service.client.get(f"/jobs/{job}").status_code == 404
    assert service.stop() == 0, service.output()


def test_a_machine_that_goes_is_noticed(database_url: str, tmp_path: Path) -> None:
    for url, more in ((database_url, {}), (f"{database_url}?connect_timeout=77", {"connect_timeout": 77})):
        engine = create_engine(Settings(data_dir=tmp_path, database_url=url))
        with engine.connect() as connection:
            parameters = connection.connection.dbapi_connection.info.get_parameters()  # type: ignore[union-attr]
        engine.dispose()
        expected = {name: str(value) for name, value in (CONNECTION | more).items()}
        assert {name: parameters[name] for name in expected} == expected


def test_who_freezes_in_a_transaction_loses_its_locks(
    database_url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = Settings(data_dir=tmp_path, database_url=database_url)
    with open_board(settings) as board:
        job = board.submit()
        # Of the one who freezes alone: on a busy machine half a second passes between two statements of any other.
        monkeypatch.setattr("service.database.engine.IDLE_SECONDS", 0.5)
        frozen = create_engine(settings)
        with frozen.connect() as connection:
            connection.execute(sa.text("UPDATE pcdnf_jobs SET losses = 9"))
            assert board.attempts.acquire(job.id) is not None  # waits for the lock
            with pytest.raises(sa.exc.DBAPIError) as caught:
                connection.execute(sa.text("SELECT 1"))
            assert caught.value.connection_invalidated  # for which a worker tries again
        assert board.now(job).crashes == 0
        frozen.dispose()


def test_two_who_drain_at_once_agree(database_url: str, tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path, database_url=database_url)
    with open_board(settings) as board, ThreadPoolExecutor() as pool:
        with board.engine.begin() as connection:
            drain_switch.set_switch(connection, drain_switch.DRAIN, on=True)
            other = pool.submit(drain, settings, on=True, wait=False)
            with pytest.raises(TimeoutError):
                other.result(5)  # it waits for this transaction
        other.result(30)
        with board.engine.connect() as connection:
            assert drain_switch.is_on(connection, drain_switch.DRAIN)
