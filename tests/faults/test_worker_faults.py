"""Two workers on one queue, and one that freezes and comes back."""

from __future__ import annotations

import signal
import time
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from tests.support.apart import TILE, Apart, nothing_left_over, succeeded, tiles, until
from tests.support.injection import inject
from tests.support.service_process import write_sphere


def _ready(service: Apart) -> int:
    return [worker["state"] for worker in service.client.get("/readyz").json()["workers"]].count("ready")


def test_two_workers_on_one_queue_do_nothing_twice(tmp_path: Path) -> None:
    service = Apart(tmp_path / "service", tile_points=TILE).start()
    service.start_worker("worker-1")
    until(lambda: _ready(service) == 2, 90)
    path = write_sphere(tmp_path / "a.ply", 6 * TILE)
    jobs = [service.submit(path)["id"] for _ in range(6)]  # of which one worker takes four at a time
    results = {succeeded(service, job) for job in jobs}
    assert len(results) == 1
    for job in jobs:
        assert set(tiles(service, job).values()) == {1}
    by = {line.split()[3] for line in service.output().splitlines() if "tile 0-1024 done" in line}
    assert by == {str(worker.pid) for worker in service.workers.values()}
    nothing_left_over(service)
    assert service.stop() == 0, service.output()


def freeze_before_the_second_tile_is_stored(steps: ModuleType) -> None:
    import os
    import signal
    import sqlite3
    from pathlib import Path

    store = steps.store_arrays

    def stored(runtime: Any, job_id: str, name: str, **arrays: Any) -> None:
        mark = Path(os.environ["FROZEN"])
        if name.startswith("tiles/0-1024") and not mark.exists():
            mark.touch()
            database = sqlite3.connect(runtime.attempts._engine.url.database, timeout=30, isolation_level=None)
            database.execute("BEGIN IMMEDIATE")  # so that no other thread freezes in a write, with SQLite's lock
            database.execute("COMMIT")
            os.kill(os.getpid(), signal.SIGSTOP)
        store(runtime, job_id, name, **arrays)

    steps.store_arrays = stored


def _freezing(tmp_path: Path) -> tuple[Apart, Path]:
    """Return a service whose worker freezes once, and the file that is there when it does."""
    service, mark = Apart(tmp_path / "service", tile_points=TILE, worker_stale_seconds=2), tmp_path / "frozen"
    inject(service, tmp_path, "service.worker.steps", freeze_before_the_second_tile_is_stored, FROZEN=mark)
    return service.start(), mark


def test_a_frozen_worker_that_comes_back(tmp_path: Path) -> None:
    service, mark = _freezing(tmp_path)
    path = write_sphere(tmp_path / "a.ply", 4 * TILE)
    job = service.submit(path)["id"]
    until(mark.exists)
    service.start_worker("worker-1")
    service.wait_done(job, 3 * TILE)
    assert "taking over the jobs of worker-0" in service.output()
    service.workers["worker-0"].send_signal(signal.SIGCONT)  # both work on the job now, or have just finished it
    expected = succeeded(service, job)
    # The other is whole: it leaves what is not its own any more, and takes new work.
    service.kill_worker("worker-1")
    assert succeeded(service, service.submit(path)["id"]) == expected
    assert succeeded(service, job) == expected
    nothing_left_over(service)
    assert service.stop() in (0, signal.SIGKILL), service.output()


def test_a_tile_that_is_stored_after_its_job_had_ended_goes(tmp_path: Path) -> None:
    service, mark = _freezing(tmp_path)
    job = service.submit(write_sphere(tmp_path / "a.ply", 3 * TILE))["id"]
    until(mark.exists)
    service.start_worker("worker-1")
    result = succeeded(service, job)
    service.workers["worker-0"].send_signal(signal.SIGCONT)
    until(lambda: "is no longer owned by this execution" in service.output())
    nothing_left_over(service)
    assert succeeded(service, job) == result
    assert service.stop() in (0, signal.SIGKILL), service.output()


@pytest.mark.slow
def test_a_worker_that_was_frozen_until_its_job_had_ended(tmp_path: Path) -> None:
    service = Apart(tmp_path / "service", tile_points=TILE, worker_stale_seconds=2).start()
    path = write_sphere(tmp_path / "a.ply", 3 * TILE)
    job = service.submit(path)["id"]
    until(lambda: service.job(job)["progress"]["done"] >= TILE)
    frozen = service.workers["worker-0"]
    frozen.send_signal(signal.SIGSTOP)
    service.start_worker("worker-1")
    result = succeeded(service, job)
    frozen.send_signal(signal.SIGCONT)
    time.sleep(3)
    assert succeeded(service, job) == result
    nothing_left_over(service)
    assert service.stop() == 0, service.output()
