"""How ``queue-1445ba2.tar.xz`` was made: the data folder of a service of commit 1445ba2, stopped with work to do.

Two workers begin two jobs and are killed in the middle of both, one job had finished before, and three more wait in the
queue, in two lanes. Everything is small. Tiles have 256 points; a finished job is kept for a hundred years, so that the
results of the recording do not expire. Run from the root of the repository, with that commit's code in a work tree::

    git worktree add --detach ../old 1445ba2
    python -m tests.data.record_queue ../old tests/data/queue-1445ba2.tar.xz
    git worktree remove ../old
"""

from __future__ import annotations

import os
import signal
import socket
import sqlite3
import subprocess
import sys
import tarfile
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import httpx
import numpy as np
from numpy.typing import NDArray

TILE = 256
SETTINGS = {
    "PCDNF_TILE_POINTS": str(TILE),
    "PCDNF_POLL_SECONDS": "0.1",
    "PCDNF_HEARTBEAT_SECONDS": "0.5",
    "PCDNF_JOB_TTL": str(100 * 365 * 24 * 3600),
    "PCDNF_PORT": "0",
}


class OldService:
    """API and workers of the old commit on one data folder, as processes of their own."""

    def __init__(self, code: Path, folder: Path) -> None:
        self.folder = folder
        self._environment = os.environ | SETTINGS | {"PYTHONPATH": str(code), "PCDNF_DATA_DIR": str(folder)}
        self._cwd = code
        self._processes: dict[str, subprocess.Popen[bytes]] = {}

    def start_api(self) -> httpx.Client:
        """Start the API and return its client."""
        listener = socket.create_server(("127.0.0.1", 0))
        self._start("api", "service.server", {"PCDNF_SOCKET_FD": str(listener.fileno())}, (listener.fileno(),))
        return httpx.Client(base_url=f"http://127.0.0.1:{listener.getsockname()[1]}", timeout=60, trust_env=False)

    def start_worker(self, name: str) -> None:
        """Start a worker of that name."""
        self._start(name, "service.worker", {"PCDNF_WORKER_ID": name}, ())

    def end(self, name: str, number: int) -> None:
        """End a process by a signal."""
        process = self._processes.pop(name)
        process.send_signal(number)
        process.wait(60)

    def _start(self, name: str, module: str, more: dict[str, str], descriptors: tuple[int, ...]) -> None:
        self._processes[name] = subprocess.Popen(
            [sys.executable, "-m", module], env=self._environment | more, cwd=self._cwd, pass_fds=descriptors
        )

    def column(self, query: str) -> list[Any]:
        """Return the first column of a query to the job database."""
        with sqlite3.connect(self.folder / "pcdnf.sqlite", timeout=30) as connection:
            return [row[0] for row in connection.execute(query)]


def sphere(count: int) -> NDArray[np.float32]:
    """Return a noisy sphere (count, 3), rounded so that it compresses."""
    random = np.random.default_rng(count)
    points = random.normal(size=(count, 3))
    points *= 1 / np.linalg.norm(points, axis=1, keepdims=True)
    return np.round(points + 0.01 * random.normal(size=points.shape), 2).astype(np.float32)


def ply(count: int) -> bytes:
    """Return a sphere as binary PLY."""
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {count}\n"
    header += "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n"
    return header.encode() + sphere(count).tobytes()


def text(count: int) -> bytes:
    """Return a sphere as lines of text."""
    return "".join(f"{x:.2f} {y:.2f} {z:.2f}\n" for x, y, z in sphere(count)).encode()


def until(question: Callable[[], Any]) -> Any:
    """Ask until the answer is true, and return it."""
    deadline = time.monotonic() + 900
    while not (answer := question()):
        assert time.monotonic() < deadline
        time.sleep(0.002)
    return answer


def record(code: Path, archive: Path) -> None:
    """Run the old service in a folder and pack what it leaves."""
    with TemporaryDirectory() as name:
        old = OldService(code, Path(name) / "data")
        client = old.start_api()
        until(lambda: _alive(client))

        def submit(file: str, content: bytes, **parameters: Any) -> str:
            answer = client.post("/denoise", files={"file": (file, content)}, params=parameters)
            assert answer.status_code == 202, answer.text
            return str(answer.json()["id"])

        old.start_worker("worker-0")
        old.start_worker("worker-1")
        until(lambda: client.get("/readyz").status_code == 200)
        until(lambda: len(client.get("/readyz").json()["workers"]) == 2)
        finished = submit("finished.ply", ply(200), iterations=1)
        until(lambda: client.get(f"/jobs/{finished}").json()["status"] == "succeeded")
        until(lambda: [worker["state"] for worker in client.get("/readyz").json()["workers"]] == ["ready"] * 2)
        begun = submit("begun.ply", ply(700), iterations=2)
        begun_done = f"SELECT done FROM pcdnf_jobs WHERE id = '{begun}'"
        until(lambda: old.column(begun_done)[0] >= TILE)
        submit("shared.ply", ply(4100), iterations=1)
        until(lambda: old.column(begun_done)[0] > 700)
        until(lambda: old.column("SELECT count(*) FROM pcdnf_shares WHERE done >= 256")[0])
        for worker in ("worker-0", "worker-1"):
            old.end(worker, signal.SIGKILL)
        submit("waiting.xyz", text(500))
        submit("waiting.ply", ply(5001), iterations=4)
        submit("waiting.ply", ply(300), radius="5%", fast=True, outliers="drop", orient=True)
        print([(job["upload"]["name"], job["status"], job["progress"]) for job in client.get("/jobs").json()])
        old.end("api", signal.SIGTERM)
        with sqlite3.connect(old.folder / "pcdnf.sqlite") as connection:  # so that one file holds it all
            connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        connection.close()
        with tarfile.open(archive, "w:xz") as tar:
            tar.add(old.folder, "data", filter=_nobodys)


def _alive(client: httpx.Client) -> bool:
    try:
        return client.get("/livez").status_code == 200
    except httpx.TransportError:
        return False


def _nobodys(member: tarfile.TarInfo) -> tarfile.TarInfo:
    member.uid = member.gid = 0
    member.uname = member.gname = ""
    return member


if __name__ == "__main__":
    record(Path(sys.argv[1]).resolve(), Path(sys.argv[2]))
