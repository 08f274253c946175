"""API processes and workers apart from one another, as on several machines: what they share is what they are told."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx

from service.supervision import EX_CONFIG
from tests.support.servers import free_port

QUICK = {
    "tile_points": 256,
    "poll_seconds": 0.3,
    "heartbeat_seconds": 0.5,
    "worker_stale_seconds": 3,
    "grace_seconds": 20,
    "threads": 1,
    "device": "cpu",
    "precision": "float32",
}


class Cluster:
    """Processes by name, each with a data folder of its own.

    Parameters
    ----------
    folder : Path
    environment : dict of str to str
        What all of them share: database, storage, and how to reach it.
    **settings
        In place of the quick ones.
    """

    def __init__(self, folder: Path, environment: dict[str, str], **settings: Any) -> None:
        self.folder = folder
        given = {key: value for key, value in os.environ.items() if not key.startswith(("PCDNF_", "AWS_"))}
        named = {f"PCDNF_{key.upper()}": str(value) for key, value in (QUICK | settings).items()}
        self.environment = given | named | environment
        self.clients: list[httpx.Client] = []
        self.processes: dict[str, subprocess.Popen[bytes]] = {}

    def __enter__(self) -> Cluster:
        return self

    def __exit__(self, *_: object) -> None:
        for client in self.clients:
            client.close()
        for process in self.processes.values():
            process.kill()
            process.wait()

    def api(self, name: str = "api") -> httpx.Client:
        """Start an API process and return its client, once it answers."""
        port = free_port()
        self._start(name, "service.api", PCDNF_PORT=str(port))
        client = httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=60, trust_env=False)
        self.clients.append(client)

        def answers() -> bool:
            with suppress(httpx.TransportError):
                return client.get("/livez").status_code == 200
            return False

        self.until(answers, name)
        return client

    def worker(self, name: str) -> None:
        """Start a worker and wait until it is ready."""
        ready = f"worker {name} ready"
        before = self.log(name).count(ready)
        self._start(name, "service.worker", PCDNF_WORKER_ID=name)
        self.until(lambda: self.log(name).count(ready) > before, name)

    def refused(self, name: str, *, as_worker: str) -> str:
        """Start a worker under the name of another and return the last line it ends with for good."""
        self._start(name, "service.worker", PCDNF_WORKER_ID=as_worker)
        assert self.processes.pop(name).wait(60) == EX_CONFIG
        return self.log(name).splitlines()[-1]

    def _start(self, name: str, module: str, **environment: str) -> None:
        environment["PCDNF_DATA_DIR"] = str(self.folder / name)
        (self.folder / name).mkdir(parents=True, exist_ok=True)
        with (self.folder / f"{name}.log").open("ab") as log:
            self.processes[name] = subprocess.Popen(
                [sys.executable, "-m", module], env=self.environment | environment, stdout=log, stderr=log
            )

    def signal(self, name: str, number: int) -> None:
        """Send a signal."""
        self.processes[name].send_signal(number)

    def kill(self, name: str) -> None:
        """End a process at once."""
        process = self.processes.pop(name)
        process.kill()
        process.wait()

    def stop(self, name: str) -> int:
        """End a process in good order and return its status."""
        self.signal(name, signal.SIGTERM)
        return self.processes.pop(name).wait(60)

    def log(self, name: str) -> str:
        """Return what a process has logged."""
        path = self.folder / f"{name}.log"
        return path.read_text() if path.exists() else ""

    def tiles(self, name: str, job_id: str) -> int:
        """Return how many tiles of a job a worker has finished."""
        return sum(f"job {job_id} iteration" in line and " tile " in line for line in self.log(name).splitlines())

    def until(self, question: Callable[[], Any], what: object, seconds: float = 240.0) -> Any:
        """Wait for a true answer and return it."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            if answer := question():
                return answer
            time.sleep(0.05)
        raise AssertionError(f"waited for {what}:\n" + "\n".join(self.log(name)[-3000:] for name in self.processes))

    def submit(self, client: httpx.Client, path: Path, **parameters: Any) -> str:
        """Upload a cloud and return the job's id."""
        response = client.post("/denoise", files={"file": (path.name, path.read_bytes())}, params=parameters)
        assert response.status_code == 202, response.text
        return str(response.json()["id"])

    def ended(self, client: httpx.Client, job_id: str, seconds: float = 240.0) -> dict[str, Any]:
        """Wait for the end of a job."""

        def look() -> dict[str, Any] | None:
            job: dict[str, Any] = client.get(f"/jobs/{job_id}").json()
            return job if job["status"] in ("succeeded", "failed", "cancelled") else None

        found: dict[str, Any] = self.until(look, job_id, seconds)
        return found
