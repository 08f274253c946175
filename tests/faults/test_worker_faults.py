"""Two workers on one queue, and one that freezes and comes back.

SQLite has one writer at a time, and its lock stays with a process that freezes. The others then wait until it thaws. A
test that thaws it only once the others have got on would wait for ever, so it has to choose the moment of the freeze.
"""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
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


def freeze_between_transactions(steps: ModuleType) -> None:
    """Freeze before the second tile is stored, while no thread of the worker has a transaction on the job database."""
    import os
    import signal
    import threading
    import time
    from pathlib import Path

    import sqlalchemy as sa

    store = steps.store_arrays

    def stored(runtime: Any, job_id: str, name: str, **arrays: Any) -> None:
        mark = Path(os.environ["FROZEN"])
        if name.startswith("tiles/0-1024") and not mark.exists():
            pool, open_again, waiting = runtime.engine.pool, threading.Event(), []

            @sa.event.listens_for(pool, "checkout")
            def wait(*_: object) -> None:
                if not open_again.is_set():
                    waiting.append(None)
                    open_again.wait()

            while pool.checkedout() > len(waiting):  # until every connection in use is one that waits above
                time.sleep(0.001)
            mark.touch()
            os.kill(os.getpid(), signal.SIGSTOP)
            time.sleep(0.5)  # the kernel stops the threads one after the other
            open_again.set()
        store(runtime, job_id, name, **arrays)

    steps.store_arrays = stored


def freeze_in_a_transaction(steps: ModuleType) -> None:
    """Freeze before the second tile is stored, with SQLite's write lock."""
    import os
    import signal
    import time
    from pathlib import Path

    store = steps.store_arrays

    def stored(runtime: Any, job_id: str, name: str, **arrays: Any) -> None:
        mark = Path(os.environ["FROZEN"])
        if name.startswith("tiles/0-1024") and not mark.exists():
            with runtime.engine.connect() as connection:
                connection.exec_driver_sql("BEGIN IMMEDIATE")
                mark.touch()
                os.kill(os.getpid(), signal.SIGSTOP)
                time.sleep(0.5)
        store(runtime, job_id, name, **arrays)

    steps.store_arrays = stored


def _freezing(tmp_path: Path, how: Callable[[ModuleType], None] = freeze_between_transactions) -> tuple[Apart, Path]:
    """Return a service whose worker freezes once, and the file that is there when it does."""
    service, mark = Apart(tmp_path / "service", tile_points=TILE, worker_stale_seconds=2), tmp_path / "frozen"
    inject(service, tmp_path, "service.worker.steps", how, FROZEN=mark)
    return service.start(), mark


def _holds_the_write_lock(service: Apart, pid: int) -> bool:
    """Return whether a process has the lock of the one writer: byte 120 of SQLite's shared memory (walformat.html)."""
    inode = (service.data / "pcdnf.sqlite-shm").stat().st_ino
    locks = [line.split() for line in Path("/proc/locks").read_text().splitlines()]
    return any(lock[4] == str(pid) and lock[5].endswith(f":{inode}") and lock[6] == "120" for lock in locks)


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


def test_a_worker_frozen_in_a_write_holds_up_the_others_until_it_thaws(tmp_path: Path) -> None:
    service, mark = _freezing(tmp_path, freeze_in_a_transaction)
    frozen = service.workers["worker-0"]
    job = service.submit(write_sphere(tmp_path / "a.ply", 3 * TILE))["id"]
    until(mark.exists)
    until(lambda: _holds_the_write_lock(service, frozen.pid))
    before = service.job(job)["progress"]["done"]
    service.start_worker("worker-1")
    time.sleep(5)  # more than twice what makes a worker stale
    assert service.job(job)["progress"]["done"] == before  # the API reads on
    assert "taking over" not in service.output()
    frozen.send_signal(signal.SIGCONT)
    until(lambda: not _holds_the_write_lock(service, frozen.pid))
    succeeded(service, job)
    nothing_left_over(service)
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
