"""kill -9 of the worker in each window of a job: the result is that of a job that nobody disturbed, byte for byte."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import httpx
import pytest

from tests.support.apart import TILE, Apart, nothing_left_over, succeeded, tiles, until
from tests.support.injection import inject
from tests.support.service_process import write_sphere

POINTS = 3 * TILE


def die_once(storage: ModuleType) -> None:
    """The process that clears a finished job away first is killed."""
    import os
    import signal

    clear = storage.LocalStorage.delete_job

    def dies(self: Any, job_id: str, *, keep: frozenset[str] = frozenset()) -> None:
        if keep and not os.path.exists(os.environ["DIED"]):
            open(os.environ["DIED"], "w").close()
            os.kill(os.getpid(), signal.SIGKILL)
        clear(self, job_id, keep=keep)

    storage.LocalStorage.delete_job = dies


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


def test_killed_between_the_end_and_the_clearing(undisturbed: tuple[Path, bytes], tmp_path: Path) -> None:
    path, expected = undisturbed
    service = Apart(tmp_path / "service", tile_points=TILE)
    inject(service, tmp_path, "service.storage.local", die_once, DIED=tmp_path / "died")
    service.start()
    job = service.submit(path)["id"]
    assert service.workers["worker-0"].wait(120) == -signal.SIGKILL
    assert service.job(job)["status"] == "succeeded"
    folder = service.data / "jobs" / job
    assert (folder / "tiles").exists()
    service.start_worker()
    until(lambda: not (folder / "tiles").exists())
    assert service.client.get(f"/jobs/{job}/result").content == expected
    until(lambda: len(list(folder.iterdir())) == 4)
    nothing_left_over(service)
    assert service.stop() == 0, service.output()


def test_api_killed_in_the_middle_of_an_upload(service: Apart, undisturbed: tuple[Path, bytes], tmp_path: Path) -> None:
    path, expected = undisturbed
    content, key = path.read_bytes(), {"Idempotency-Key": tmp_path.name, "Content-Type": "application/ply"}
    assert service.process is not None
    before = {job["id"] for job in service.client.get("/jobs?limit=100").json()}

    def half() -> Iterator[bytes]:
        yield content[: len(content) // 2]
        until(lambda: list((service.data / "scratch").iterdir()))
        assert service.process is not None
        service.process.kill()
        service.process.wait()
        yield content[len(content) // 2 :]

    with pytest.raises(httpx.TransportError):
        service.client.post("/denoise?iterations=1", content=half(), headers=key)
    service.start_api()
    held = service.client.post("/denoise?iterations=1", content=content, headers=key)
    if held.status_code == 409:  # until the lease of the dead runs out
        assert held.json()["code"] == "idempotency_key_in_use"
    answer = until(lambda: _taken(service, content, key))
    again = service.client.post("/denoise?iterations=1", content=content, headers=key).json()
    assert again["id"] == answer["id"]
    assert succeeded(service, answer["id"]) == expected
    assert {job["id"] for job in service.client.get("/jobs?limit=100").json()} == before | {answer["id"]}
    (left,) = (service.data / "scratch").iterdir()
    os.utime(left, (1, 1))  # a day later
    assert service.process is not None
    service.process.kill()
    service.process.wait()
    service.start_api()  # which looks at its start
    until(lambda: not left.exists())
    nothing_left_over(service)


def _taken(service: Apart, content: bytes, headers: dict[str, str]) -> dict[str, Any] | None:
    answer = service.client.post("/denoise?iterations=1", content=content, headers=headers)
    if answer.status_code == 202:
        return dict(answer.json())
    time.sleep(0.5)
    return None


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
