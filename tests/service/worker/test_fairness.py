"""Small jobs beside large ones, on one worker."""

from __future__ import annotations

import re
import time
from pathlib import Path
from statistics import median

import pytest

from tests.support.service_process import Service, write_sphere

pytestmark = pytest.mark.full  # they measure times, and their clouds are large


def _seconds(service: Service, path: Path) -> float:
    began = time.monotonic()
    job = service.wait_status(service.submit(path, iterations=2)["id"], "succeeded", "failed")
    assert job["status"] == "succeeded", job["problem"]
    return time.monotonic() - began


def _tiles(service: Service, job_id: str) -> int:
    return len(re.findall(rf"job {job_id} iteration \d+ tile", service.output()))


def test_a_small_job_does_not_wait_for_a_large_one(tmp_path: Path) -> None:
    service = Service(tmp_path / "service", tile_points=4096).start()
    small, large = write_sphere(tmp_path / "small.ply", 5000), write_sphere(tmp_path / "large.ply", 250_000)
    alone = min(_seconds(service, small) for _ in range(2))
    job = service.submit(large)["id"]
    service.wait_done(job, 3 * 4096)
    tile = 4096 / service.job(job)["points_per_second"]
    before = _tiles(service, job)
    assert _seconds(service, small) < 3 * alone + tile
    beside = service.job(job)
    assert beside["status"] == "running"
    assert _tiles(service, job) > before  # nor does the large one stand still
    service.client.delete(f"/jobs/{job}")
    service.wait_status(job, "cancelled", seconds=20)
    assert service.stop() == 0, service.output()


def test_seconds_left_are_right_within_a_third(running: Service, tmp_path: Path) -> None:
    job = running.submit(write_sphere(tmp_path / "a.ply", 60_000), iterations=2)
    told = []
    while (now := running.job(job["id"]))["status"] in ("queued", "running"):
        if 0.1 * now["progress"]["total"] <= now["progress"]["done"] <= 0.8 * now["progress"]["total"]:
            told.append((time.monotonic(), now["seconds_left"]))
        time.sleep(0.1)
    ended = time.monotonic()
    assert now["status"] == "succeeded"
    assert len(told) > 5
    assert 2 / 3 < median(left / (ended - when) for when, left in told) < 4 / 3
