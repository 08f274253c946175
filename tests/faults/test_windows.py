"""kill -9 of the worker in each window of a job: the result is that of a job that nobody disturbed, byte for byte."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from apart import TILE, Apart, nothing_left_over, tiles, until
from service_process import write_sphere

POINTS = 3 * TILE


def _done(service: Apart, folder: Path) -> int:
    return int(service.job(folder.name)["progress"]["done"])


WINDOWS: dict[str, Any] = {
    "survey": lambda service, folder: service.job(folder.name)["status"] == "running",
    "in a tile": lambda service, folder: _done(service, folder) == TILE,
    "before the checkpoint of a tile": lambda _, folder: any((folder / "tiles").glob(f"0-{TILE}-*")),
    "after the checkpoint of a tile": lambda service, folder: _done(service, folder) >= 2 * TILE,
    "merge": lambda _, folder: any(folder.glob("iteration-0-*")),
    "writing the result": lambda service, _: any((service.data / "scratch").iterdir()),
    "after the result is written": lambda _, folder: any(folder.glob("result-*.ply")),
    "after the last file": lambda _, folder: (folder / "display.glb").exists(),
}
QUICK = ("before the checkpoint of a tile", "writing the result", "after the last file")


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Apart]:
    service = Apart(tmp_path_factory.mktemp("service"), tile_points=TILE).start()
    yield service
    assert service.stop() == 0, service.output()


@pytest.fixture(scope="module")
def undisturbed(service: Apart, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, bytes]:
    path = write_sphere(tmp_path_factory.mktemp("clouds") / "a.ply", POINTS)
    job = service.wait_status(service.submit(path)["id"], "succeeded")
    return path, service.client.get(f"/jobs/{job['id']}/result").content


@pytest.mark.parametrize(
    "window", [window if window in QUICK else pytest.param(window, marks=pytest.mark.slow) for window in WINDOWS]
)
def test_killed_worker(service: Apart, undisturbed: tuple[Path, bytes], window: str) -> None:
    path, expected = undisturbed
    job = service.submit(path)["id"]
    until(lambda: WINDOWS[window](service, service.data / "jobs" / job))
    service.kill_worker()
    service.start_worker()
    ended = service.wait_status(job, "succeeded", "failed")
    assert ended["status"] == "succeeded", ended["problem"]
    assert ended["progress"]["done"] == ended["progress"]["total"]
    assert service.client.get(f"/jobs/{job}/result").content == expected
    assert sum(tiles(service, job).values()) <= POINTS // TILE + 1
    for half_written in (service.data / "scratch").iterdir():  # goes by its age, see test_retention.py
        half_written.unlink()
    nothing_left_over(service)


def test_killed_right_after_202(service: Apart, undisturbed: tuple[Path, bytes]) -> None:
    path, expected = undisturbed
    jobs = [service.submit(path)["id"]]
    assert service.process is not None
    service.process.kill()
    service.process.wait()
    service.kill_worker()
    service.start_api()
    service.start_worker()
    for job in jobs:
        assert service.wait_status(job, "succeeded", "failed")["status"] == "succeeded"
        assert service.client.get(f"/jobs/{job}/result").content == expected
    nothing_left_over(service)
