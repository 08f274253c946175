"""The service as its users run it: real processes, for the tests that need them."""

from __future__ import annotations

import atexit
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any, ClassVar

import httpx
import numpy as np
import uvicorn
from fastapi import FastAPI

from pcdnf.formats import PointCloud, write
from service.api.server import configuration

START_SECONDS = 240.0
KEY = "opensesame-opensesame"  # of the service that asks for one
ONE_BY_ONE = httpx.Limits(max_keepalive_connections=0)  # a connection each, so that none is closed under a request
QUICK = {"tile_points": 1024, "poll_seconds": 0.5, "heartbeat_seconds": 1, "grace_seconds": 20}  # idle ones cost too


class Served:
    """An application behind a real socket, in a thread of this process."""

    def __init__(self, app: FastAPI) -> None:
        self.app = app
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.address: tuple[str, int] = self.listener.getsockname()
        served = configuration(app, app.state.settings)
        served.timeout_graceful_shutdown = 5
        self.server = uvicorn.Server(served)
        self.thread = threading.Thread(target=self.server.run, kwargs={"sockets": [self.listener]})
        self.client = httpx.Client(
            base_url=f"http://127.0.0.1:{self.address[1]}", timeout=30, trust_env=False, limits=ONE_BY_ONE
        )

    def __enter__(self) -> httpx.Client:
        self.thread.start()
        while not self.server.started:
            assert self.thread.is_alive(), "the application did not start"
            time.sleep(0.005)
        return self.client

    def __exit__(self, *_: object) -> None:
        self.client.close()
        self.server.should_exit = True
        self.thread.join(20)
        self.listener.close()


class Service:
    """``python -m service`` in a folder of its own.

    One that is not stopped, because a test failed before, is killed: after the test that started it (``conftest.py``),
    or at the end of this process.
    """

    alive: ClassVar[set[Service]] = set()

    def __init__(self, folder: Path, **settings: Any) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.log = folder / "log"
        self.data = folder / "data"
        given = {"host": "127.0.0.1", "port": 0, "data_dir": self.data} | QUICK | settings
        self.environment = {key: value for key, value in os.environ.items() if not key.startswith("PCDNF_")}
        self.environment |= {f"PCDNF_{key.upper()}": str(value) for key, value in given.items()}
        self.process: subprocess.Popen[bytes] | None = None
        self.client = httpx.Client()

    def start(self, *, ready: bool = True) -> Service:
        """Start it and wait until it answers, and until it is ready."""
        with self.log.open("ab") as log:
            begin = self.log.stat().st_size
            self.process = subprocess.Popen(
                [sys.executable, "-m", "service"], env=self.environment, stdout=log, stderr=log
            )
        Service.alive.add(self)
        try:
            return self._started(begin, ready)
        except BaseException:
            self.kill()
            raise

    def _started(self, begin: int, ready: bool) -> Service:
        prefix = "PCDNF listens on "
        lines = self._until(
            lambda: [line for line in self.output(begin).splitlines() if line.startswith(prefix)], "address"
        )
        self.client.close()
        self.client = httpx.Client(
            base_url=lines[0].removeprefix(prefix), timeout=30, trust_env=False, limits=ONE_BY_ONE
        )
        if ready:
            self.wait_ready()
        return self

    def wait_ready(self) -> None:
        """Wait for /readyz."""
        self._until(lambda: self.client.get("/readyz").status_code == 200, "ready")

    def output(self, begin: int = 0) -> str:
        """Return what was logged."""
        return self.log.read_bytes()[begin:].decode()

    def children(self) -> list[int]:
        """Return the process ids of the supervisor's children."""
        assert self.process is not None
        return [
            int(pid) for pid in Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text().split()
        ]

    def child(self, module: str) -> int:
        """Return the process id of ``service.api`` or ``service.worker``."""
        for child in self.children():
            if module.encode() in Path(f"/proc/{child}/cmdline").read_bytes():
                return child
        raise AssertionError(f"no {module} among the children")

    def wait_child(self, module: str, *, other_than: int) -> int:
        """Wait for a new process of that module."""

        def found() -> int | None:
            try:
                pid = self.child(module)
            except (AssertionError, FileNotFoundError):
                return None
            return pid if pid != other_than else None

        return int(self._until(found, module))

    def stop(self, number: int = signal.SIGTERM) -> int:
        """Stop it and return the exit status."""
        self.client.close()
        if self.process is None:
            return 0
        if self.process.poll() is None:
            self.process.send_signal(number)
        try:
            status = self.process.wait(60)
        except subprocess.TimeoutExpired:
            self.kill()
            raise
        self.process = None
        Service.alive.discard(self)
        return status

    def kill(self) -> None:
        """End every process of it at once, frozen ones as well."""
        self.client.close()
        if self.process is not None and self.process.poll() is None:
            for pid in (self.process.pid, *self.children()):
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
            self.process.wait()
        self.process = None
        Service.alive.discard(self)

    def submit(self, path: Path, **parameters: Any) -> dict[str, Any]:
        """Upload a file and return the job."""
        given = {"iterations": 1} | parameters
        response = self.client.post("/denoise", files={"file": (path.name, path.read_bytes())}, params=given)
        assert response.status_code == 202, response.text
        job: dict[str, Any] = response.json()
        return job

    def job(self, job_id: str) -> dict[str, Any]:
        """Return the job as it is now."""
        job: dict[str, Any] = self.client.get(f"/jobs/{job_id}").json()
        return job

    def wait_status(self, job_id: str, *statuses: str, seconds: float = 120.0) -> dict[str, Any]:
        """Wait until the job has one of `statuses`."""
        job = self._until(
            lambda: found if (found := self.job(job_id))["status"] in statuses else None, statuses, seconds
        )
        return dict(job)

    def wait_done(self, job_id: str, points: int, seconds: float = 120.0) -> dict[str, Any]:
        """Wait until so many points are done."""
        return dict(
            self._until(
                lambda: found if (found := self.job(job_id))["progress"]["done"] >= points else None, points, seconds
            )
        )

    def _until(self, question: Any, what: object, seconds: float = START_SECONDS) -> Any:
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            assert self.process is None or self.process.poll() is None, f"the service ended:\n{self.output()}"
            try:
                answer = question()
            except httpx.TransportError:
                answer = None
            if answer:
                return answer
            time.sleep(0.05)
        raise AssertionError(f"waited {seconds} s for {what}:\n{self.output()[-4000:]}")


@atexit.register
def kill_all() -> None:
    """Leave no process behind."""
    for service in list(Service.alive):
        service.kill()


def sphere(count: int, seed: int = 0) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return a noisy unit sphere (count, 3) float64."""
    random = np.random.default_rng(seed)
    points = random.normal(size=(count, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return points + 0.01 * random.normal(size=points.shape)


def write_sphere(path: Path, count: int, seed: int = 0) -> Path:
    """Write a noisy sphere in the format of the suffix."""
    cloud = PointCloud(points=sphere(count, seed).astype(np.float32))
    write(path, cloud, format="npz" if path.suffix == ".npz" else "ply")
    return path
