"""Processes that die apart, and what is looked at after a fault."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx

from tests.support.service_process import ONE_BY_ONE, Service

TILE = 1024


class Apart(Service):
    """API and workers without a supervisor, so that one can be killed and another started at once."""

    def __init__(self, folder: Path, **settings: Any) -> None:
        super().__init__(folder, **settings)
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.workers: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, *, ready: bool = True) -> Apart:
        """Start the API and a worker."""
        Service.alive.add(self)
        self.client = httpx.Client(
            base_url=f"http://127.0.0.1:{self.listener.getsockname()[1]}",
            timeout=60,
            trust_env=False,
            limits=ONE_BY_ONE,
        )
        self.start_api()
        self.start_worker()
        if ready:
            self.wait_ready()
        return self

    def start_api(self) -> None:
        """Start the API on the socket, which stays open without it."""
        descriptor = self.listener.fileno()
        self.process = self._run("service.api", {"PCDNF_SOCKET_FD": str(descriptor)}, (descriptor,))

    def start_worker(self, name: str = "worker-0") -> subprocess.Popen[bytes]:
        """Start a worker of that name."""
        self.workers[name] = self._run("service.worker", {"PCDNF_WORKER_ID": name}, ())
        return self.workers[name]

    def _run(self, module: str, more: dict[str, str], descriptors: tuple[int, ...]) -> subprocess.Popen[bytes]:
        with self.log.open("ab") as log:
            return subprocess.Popen(
                [sys.executable, "-m", module],
                env=self.environment | more,
                stdout=log,
                stderr=log,
                pass_fds=descriptors,
            )

    def kill_worker(self, name: str = "worker-0") -> None:
        """End a worker as a crash does."""
        self.workers[name].kill()
        self.workers[name].wait()

    def processes(self) -> list[subprocess.Popen[bytes]]:
        """Return those that were started last."""
        assert self.process is not None
        return [self.process, *self.workers.values()]

    def stop(self, number: int = signal.SIGTERM) -> int:
        """Stop all; return 0 if each of them ended well."""
        processes = self.processes()
        for process in processes:
            process.send_signal(number)
        status = max(abs(process.wait(60)) for process in processes)
        self.kill()
        return status

    def kill(self) -> None:
        """End every process at once."""
        self.client.close()
        for process in self.processes() if self.process is not None else []:
            process.kill()
            process.wait()
        self.listener.close()
        self.process = None
        Service.alive.discard(self)


def tiles(service: Service, job_id: str) -> Counter[str]:
    """Return how often each tile of a job was computed, from the log."""
    return Counter(re.findall(rf"job {job_id} iteration \d+ (tile \S+) done", service.output()))


def until(question: Callable[[], Any], seconds: float = 60.0) -> Any:
    """Ask very often until the answer is something, and return it."""
    deadline = time.monotonic() + seconds
    while not (answer := question()):
        assert time.monotonic() < deadline, "it never happened"
        time.sleep(0.0005)
    return answer


def nothing_left_over(service: Service) -> None:
    """Check that every folder has its job, that finished jobs have results alone, and that no writer left a file.

    A worker that was killed right after a job had ended leaves the files to whoever takes over from it, so they may
    take some seconds to go.
    """
    deadline = time.monotonic() + 15
    while (left := _left_over(service)) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not left, "\n".join([*left, service.output()])


def _left_over(service: Service) -> list[str]:
    jobs = {job["id"]: job["status"] for job in service.client.get("/jobs", params={"limit": 100}).json()}
    left = [str(path) for path in (service.data / "scratch").iterdir()]
    for folder in (service.data / "jobs").iterdir():
        if jobs.get(folder.name) not in ("queued", "running", "cancelling"):
            names = sorted(re.sub("-[0-9a-f]{8}", "", path.name) for path in folder.iterdir())
            if folder.name not in jobs or names != ["display.glb", "result.npz", "result.ply", "upload"]:
                left.append(f"{folder.name}, {jobs.get(folder.name)}: {names}")
    return left


def succeeded(service: Service, job_id: str) -> bytes:
    """Wait for a job to succeed, and return its result."""
    job = service.wait_status(job_id, "succeeded", "failed", "cancelled")
    assert job["status"] == "succeeded", job["problem"]
    assert job["progress"]["done"] == job["progress"]["total"]
    return service.client.get(f"/jobs/{job_id}/result").content


def fill(disk: Path, leave: int = 0) -> Path:
    """Fill a disk, though others write to it, too, up to so many bytes; return the file that does it."""
    ballast = disk / "ballast"
    with ballast.open("wb", buffering=0) as file, suppress(OSError):
        while True:
            file.write(bytes(65536))
    os.truncate(ballast, max(0, ballast.stat().st_size - leave))
    return ballast
