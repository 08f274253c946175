"""kill -9 in the middle of things: nothing accepted is lost, nothing finished is computed again."""

from __future__ import annotations

import os
import re
import signal
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.service_process import Service, write_sphere

POINTS, TILE = 12_000, 1024


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    service = Service(tmp_path_factory.mktemp("service"), tile_points=TILE).start()
    yield service
    assert service.stop() == 0, service.output()


def _tiles(service: Service, job_id: str) -> Counter[str]:
    """Return how often each tile of a job was computed, from the log."""
    return Counter(re.findall(rf"job {job_id} iteration \d+ (tile \S+) done", service.output()))


def test_killed_worker_resumes_at_the_missing_tile(service: Service, tmp_path: Path) -> None:
    path = write_sphere(tmp_path / "a.ply", POINTS)
    job = service.submit(path)["id"]
    service.wait_done(job, 3 * TILE)
    worker = service.child("service.worker")
    os.kill(worker, signal.SIGKILL)
    service.wait_child("service.worker", other_than=worker)
    resumed = service.wait_status(job, "succeeded", "failed")
    assert resumed["status"] == "succeeded", resumed["problem"]
    tiles = _tiles(service, job)
    assert len(tiles) == -(-POINTS // TILE)
    # A tile whose checkpoint the kill cut off is the only one that may have been computed twice.
    assert sum(tiles.values()) <= len(tiles) + 1
    undisturbed = service.wait_status(service.submit(path)["id"], "succeeded")
    first, second = (service.client.get(f"/jobs/{found['id']}/result").content for found in (resumed, undisturbed))
    assert first == second


def test_killed_api_loses_no_accepted_job(service: Service, tmp_path: Path) -> None:
    path = write_sphere(tmp_path / "a.ply", 2000)
    jobs = [service.submit(path)["id"] for _ in range(3)]
    api = service.child("service.api")
    os.kill(api, signal.SIGKILL)
    # The supervisor holds the socket, so the next request waits for the new process instead of being refused.
    assert service.client.get("/livez").status_code == 200
    assert service.child("service.api") != api
    for job in jobs:
        assert service.wait_status(job, "succeeded", "failed")["status"] == "succeeded"


def test_killed_service_goes_on_after_a_restart(service: Service, tmp_path: Path) -> None:
    running = service.submit(write_sphere(tmp_path / "a.ply", POINTS))["id"]
    queued = service.submit(write_sphere(tmp_path / "b.ply", 2000))["id"]
    service.wait_done(running, TILE)
    for pid in (service.child("service.worker"), service.child("service.api")):
        os.kill(pid, signal.SIGKILL)
    service.stop(signal.SIGKILL)
    service.start()
    for job in (running, queued):
        assert service.wait_status(job, "succeeded", "failed")["status"] == "succeeded"
    assert sum(_tiles(service, running).values()) <= -(-POINTS // TILE) + 1


def test_a_clean_stop_finishes_the_tile_and_counts_as_no_death(service: Service, tmp_path: Path) -> None:
    job = service.submit(write_sphere(tmp_path / "a.ply", POINTS))["id"]
    for tiles in (1, 4):
        service.wait_done(job, tiles * TILE)
        assert service.stop() == 0, service.output()
        service.start()
    assert service.wait_status(job, "succeeded", "failed")["status"] == "succeeded"
    assert set(_tiles(service, job).values()) == {1}


def test_a_job_that_kills_its_worker_twice_fails(tmp_path: Path) -> None:
    service = Service(tmp_path / "service", tile_points=100_000).start()
    job = service.submit(write_sphere(tmp_path / "a.ply", 60_000))["id"]
    innocent = service.submit(write_sphere(tmp_path / "b.ply", 2000))["id"]
    waiting = service.submit(write_sphere(tmp_path / "c.ply", 70_000))["id"]  # in hand, but for its turn
    for _ in range(2):
        service.wait_status(job, "running")
        worker = service.child("service.worker")
        done = service.job(job)["progress"]["done"]
        deadline = time.monotonic() + 120
        while service.job(job)["progress"]["done"] == done:  # until this worker is inside the only tile
            assert time.monotonic() < deadline, service.output()
            time.sleep(0.05)
        os.kill(worker, signal.SIGKILL)
        service.wait_child("service.worker", other_than=worker)
    failed = service.wait_status(job, "failed", "succeeded")
    assert failed["status"] == "failed"
    assert failed["problem"]["code"] == "worker_lost"
    for other in (innocent, waiting):
        assert service.wait_status(other, "succeeded", "failed")["status"] == "succeeded"
    response = service.client.get(f"/jobs/{job}/result")
    assert (response.status_code, response.json()["cause"]) == (409, "worker_lost")
    assert service.stop() == 0


def test_another_worker_takes_over(tmp_path: Path) -> None:
    settings = {"tile_points": TILE, "worker_stale_seconds": 2}
    first = Service(tmp_path / "service", worker_id="first", **settings).start()
    job = first.submit(write_sphere(tmp_path / "a.ply", POINTS))["id"]
    first.wait_done(job, TILE)
    worker = first.child("service.worker")
    assert first.process is not None
    os.kill(first.process.pid, signal.SIGSTOP)  # or it would start the worker again
    os.kill(worker, signal.SIGKILL)
    second = Service(tmp_path / "service", worker_id="second", **settings).start()
    assert second.wait_status(job, "succeeded", "failed")["status"] == "succeeded"
    assert "taking over the jobs of first" in second.output()
    assert second.stop() == 0
    os.kill(first.process.pid, signal.SIGCONT)
    assert first.stop() == 0
