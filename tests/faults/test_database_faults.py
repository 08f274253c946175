"""The job database is locked by somebody else, or away for a while."""

from __future__ import annotations

import os
import shlex
import sqlite3
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psycopg

from service.operations.supervisor import KILL_MARGIN
from tests.support.apart import TILE, Apart, nothing_left_over, succeeded, until
from tests.support.servers import postgresql
from tests.support.service_process import write_sphere


def test_a_locked_database_holds_everything_up_and_loses_nothing(tmp_path: Path) -> None:
    service = Apart(tmp_path / "service", tile_points=TILE).start()
    path = write_sphere(tmp_path / "a.ply", 4 * TILE)
    running = service.submit(path)["id"]
    until(lambda: service.job(running)["progress"]["done"] >= TILE)
    other = sqlite3.connect(service.data / "pcdnf.sqlite", isolation_level=None, check_same_thread=False)
    other.execute("BEGIN EXCLUSIVE")
    began = time.monotonic()
    threading.Timer(2, lambda: other.execute("ROLLBACK")).start()  # before the API gives up
    assert service.client.get(f"/jobs/{running}").json()["status"] == "running"  # reading goes on
    assert service.client.get("/livez").status_code == 200
    waited = service.submit(path)["id"]
    assert time.monotonic() - began > 1.5
    assert succeeded(service, running) == succeeded(service, waited)
    nothing_left_over(service)
    other.close()
    assert service.stop() == 0, service.output()


@contextmanager
def away(url: str) -> Iterator[None]:
    """Stop a PostgreSQL server as a crash does, and start it again."""
    with psycopg.connect(url) as connection:
        row = connection.execute("show data_directory").fetchone()
    assert row is not None
    data = Path(row[0])
    pid = int((data / "postmaster.pid").read_text().split()[0])
    control = [Path(f"/proc/{pid}/exe").resolve().with_name("pg_ctl"), "-D", data, "-w"]
    user = data.owner() if os.getuid() == 0 else None
    options = shlex.split((data / "postmaster.opts").read_text())[3:]
    subprocess.run([*control, "-m", "immediate", "stop"], user=user, check=True, capture_output=True)
    try:
        yield
    finally:
        start = [*control, "-l", data.parent / "log", "-o", shlex.join(options), "start"]
        subprocess.run(start, user=user, check=True, capture_output=True)


def test_a_worker_that_stops_while_the_database_is_away(tmp_path: Path) -> None:
    with postgresql() as url:
        service = Apart(tmp_path / "service", tile_points=TILE, database_url=url, grace_seconds=3).start()
        job = service.submit(write_sphere(tmp_path / "a.ply", 4 * TILE))["id"]
        until(lambda: service.job(job)["progress"]["done"] >= TILE)
        worker = service.workers["worker-0"]
        with away(url):
            began = time.monotonic()
            worker.terminate()
            assert worker.wait(30) == 0, service.output()
            assert time.monotonic() - began < 3 + KILL_MARGIN
        assert "Traceback" not in service.output().partition("worker worker-0 stops")[2]
        service.start_worker()
        succeeded(service, job)
        nothing_left_over(service)
        assert service.stop() == 0, service.output()


def test_a_database_that_is_away_holds_everything_up_and_loses_nothing(tmp_path: Path) -> None:
    with postgresql() as url:
        service = Apart(tmp_path / "service", tile_points=TILE, database_url=url).start()
        path = write_sphere(tmp_path / "a.ply", 4 * TILE)
        running = service.submit(path)["id"]
        queued = service.submit(path)["id"]
        until(lambda: service.job(running)["progress"]["done"] >= TILE)
        with away(url):
            refused = service.client.post("/denoise", files={"file": path.read_bytes()})
            assert (refused.status_code, refused.json()["code"]) == (503, "database_unavailable")
            assert "psycopg" not in refused.text
            assert service.client.get("/livez").status_code == 200
            assert service.client.get("/readyz").json()["code"] == "not_ready"
            time.sleep(5)  # longer than a step is tried again for other reasons
        assert succeeded(service, running) == succeeded(service, queued)
        service.wait_ready()
        succeeded(service, service.submit(path)["id"])
        nothing_left_over(service)
        assert service.stop() == 0, service.output()
