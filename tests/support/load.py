"""What the scripts of this folder share."""

from __future__ import annotations

import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx

from tests.support.service_process import Service, write_sphere

__all__ = ["Service", "fail_unless", "finished", "patiently", "service_in", "write_sphere"]

READY_SECONDS = 600.0
DEFAULTS = {"tile_points": 16_384, "poll_seconds": 0.5, "heartbeat_seconds": 5}  # not those of the quick tests


@contextmanager
def service_in(**settings: Any) -> Iterator[Service]:
    """Run a service with its worker in a folder of its own, which goes with it."""
    folder = Path(tempfile.mkdtemp(prefix="pcdnf-load-"))
    service = Service(folder / "service", **DEFAULTS | settings)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # or the service would be left behind
    try:
        service.start(ready=False)
        deadline = time.monotonic() + READY_SECONDS
        while service.client.get("/readyz").status_code != 200:
            fail_unless(time.monotonic() < deadline, f"the service did not become ready:\n{service.output()[-2000:]}")
            time.sleep(0.5)
        yield service
        fail_unless(service.stop() == 0, f"the service did not stop well:\n{service.output()[-2000:]}")
    finally:
        service.stop()
        shutil.rmtree(folder, ignore_errors=True)


def patiently(client: httpx.Client, method: str, path: str, seconds: float = 600.0, **options: Any) -> httpx.Response:
    """Send a request, and again after `Retry-After` while the service has no room."""
    deadline = time.monotonic() + seconds
    while True:
        response = client.request(method, path, **options)
        if response.status_code not in (429, 503) or time.monotonic() > deadline:
            return response
        time.sleep(min(5.0, float(response.headers.get("retry-after", 1))))


def finished(client: httpx.Client, job_id: str, seconds: float = 600.0, pause: float = 0.2) -> dict[str, Any]:
    """Wait for the end of a job, asking every `pause` seconds, and return it."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        job: dict[str, Any] = patiently(client, "GET", f"/jobs/{job_id}").json()
        if job["status"] in ("succeeded", "failed", "cancelled"):
            return job
        time.sleep(pause)
    raise SystemExit(f"job {job_id} did not end within {seconds:g} s")


def fail_unless(condition: bool, reason: str) -> None:
    """End the script with a reason where the service did not hold."""
    if not condition:
        raise SystemExit(f"FAILED: {reason}")
