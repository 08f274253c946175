"""A disk that fills up, a real one: at an upload, at a tile, at the result."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from tests.support.apart import TILE, Apart, fill, nothing_left_over, succeeded, until
from tests.support.service_process import write_sphere


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return write_sphere(tmp_path / "a.ply", 3 * TILE)


def test_at_the_upload(small_disk: Path, tmp_path: Path, path: Path) -> None:
    service = Apart(tmp_path / "service", tile_points=TILE, data_dir=small_disk / "data", min_free_bytes=0)
    service.data = small_disk / "data"
    service.start()
    for leave in (0, 8192, path.stat().st_size // 2):  # for the first of them the database has no room either
        ballast = fill(small_disk, leave)
        response = service.client.post("/denoise", files={"file": path.read_bytes()})
        assert (response.status_code, response.json()["code"]) == (503, "disk_full"), leave
        assert response.headers["retry-after"]
        ballast.unlink()
        assert service.client.get("/jobs").json() == []
        nothing_left_over(service)
    succeeded(service, service.submit(path)["id"])
    nothing_left_over(service)
    assert service.stop() == 0, service.output()


@pytest.mark.parametrize(
    ("database", "moment"),
    [
        ("on it", "tiles/0-0-*"),
        pytest.param("on it", "iteration-0-*", marks=pytest.mark.slow),
        pytest.param("elsewhere", "tiles/0-0-*", marks=pytest.mark.slow),
        ("elsewhere", "iteration-0-*"),
    ],
)
def test_at_a_tile_and_at_the_result(small_disk: Path, tmp_path: Path, path: Path, database: str, moment: str) -> None:
    url = f"sqlite:///{(small_disk if database == 'on it' else tmp_path) / 'jobs.sqlite'}"
    service = Apart(
        tmp_path / "service", tile_points=TILE, data_dir=small_disk / "data", min_free_bytes=0, database_url=url
    )
    service.data = small_disk / "data"
    service.start()
    job = service.submit(path)["id"]
    until(lambda: list((service.data / "jobs" / job).glob(moment)))
    worker = service.workers["worker-0"]
    worker.send_signal(signal.SIGSTOP)  # or it might be done before the disk is full
    ballast = fill(small_disk)
    worker.send_signal(signal.SIGCONT)
    until(lambda: "the disk is full" in service.output() or "disk is full" in service.output())
    assert service.job(job)["status"] == "running"  # it waits
    ballast.unlink()
    result = succeeded(service, job)
    assert succeeded(service, service.submit(path)["id"]) == result
    nothing_left_over(service)
    assert service.stop() == 0, service.output()
