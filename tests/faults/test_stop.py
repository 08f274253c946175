"""SIGTERM under load: what was answered 202 is there after the next start."""

from __future__ import annotations

import signal
import threading
import time
from pathlib import Path

import httpx

from tests.support.apart import TILE, nothing_left_over, succeeded
from tests.support.service_process import Service, write_sphere


def test_a_stop_under_load(tmp_path: Path) -> None:
    service = Service(tmp_path / "service", tile_points=TILE).start()
    path = write_sphere(tmp_path / "a.ply", 2 * TILE)
    content, url = path.read_bytes(), str(service.client.base_url.join("/denoise?iterations=1"))
    accepted: list[str] = []
    others: set[int] = set()
    stop = threading.Event()

    def caller() -> None:
        while not stop.is_set():
            try:
                answer = httpx.post(url, files={"file": content}, timeout=30, trust_env=False)
            except httpx.TransportError:
                continue
            if answer.status_code == 202:
                accepted.append(answer.json()["id"])
            else:
                others.add(answer.status_code)

    callers = [threading.Thread(target=caller) for _ in range(4)]
    for thread in callers:
        thread.start()
    deadline = time.monotonic() + 60
    while len(accepted) < 4:
        assert time.monotonic() < deadline
        time.sleep(0.05)
    began = time.monotonic()
    assert service.stop(signal.SIGTERM) == 0, service.output()
    assert time.monotonic() - began < 25  # within the grace period
    stop.set()
    for thread in callers:
        thread.join(40)
    assert others <= {503}
    service.start()
    results = {succeeded(service, job) for job in accepted}
    assert len(results) == 1
    assert {job["id"] for job in service.client.get("/jobs?limit=100").json()} >= set(accepted)
    nothing_left_over(service)
    assert service.stop() == 0, service.output()
