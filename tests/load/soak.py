"""Everything at once for a long time, with flat memory and descriptors: ``python -m tests.load.soak [--minutes 30]``.

Clients submit, follow, fetch, repeat, cancel, remove and send nonsense. Every few seconds the resident memory, the open
descriptors and the threads of each process are written to ``--csv``; at the end the last third of the time is compared
with the one before.
"""

from __future__ import annotations

import argparse
import csv
import random
import threading
import time
import uuid
from collections import Counter
from pathlib import Path
from statistics import median

import httpx

from tests.support.load import Service, fail_unless, finished, patiently, service_in, write_sphere

SAMPLE_SECONDS = 2.0
MEMORY_GROWTH, MEMORY_SLACK = 0.05, 16 * 2**20  # between two thirds of the time
DESCRIPTOR_SLACK, THREAD_SLACK = 6, 6
Sample = tuple[float, str, int, int, int]


def sample(service: Service, seconds: float) -> list[Sample]:
    """Return memory in bytes, descriptors and threads of every process."""
    assert service.process is not None
    names = {"supervisor": service.process.pid}
    names |= {"API": service.child("service.api"), "worker": service.child("service.worker")}
    rows = []
    for name, pid in names.items():
        status = Path(f"/proc/{pid}/status").read_text().split()
        memory = int(status[status.index("VmRSS:") + 1]) * 1024
        threads = int(status[status.index("Threads:") + 1])
        rows.append((seconds, name, memory, len(list(Path(f"/proc/{pid}/fd").iterdir())), threads))
    return rows


class Caller(threading.Thread):
    """One client that does one thing after another until it is told to stop."""

    def __init__(self, service: Service, paths: list[Path], stop: threading.Event, seed: int, pause: float) -> None:
        super().__init__(name=f"caller {seed}")
        self.counts: Counter[str] = Counter()
        self.error: Exception | None = None
        self._base = service.client.base_url
        self._files = [path.read_bytes() for path in paths]
        self._stop_, self._random, self._pause = stop, random.Random(seed), pause

    def run(self) -> None:
        doings = [self.submit, self.repeat, self.follow, self.cancel, self.nonsense]
        try:
            with httpx.Client(base_url=self._base, timeout=120, trust_env=False) as client:
                while not self._stop_.wait(self._pause):
                    doing = self._random.choice(doings)
                    doing(client)
                    self.counts[doing.__name__] += 1
        except Exception as error:
            self.error = error

    def _post(self, client: httpx.Client, **headers: str) -> str:
        content = self._random.choice(self._files)
        named = {name.replace("_", "-"): value for name, value in headers.items()}
        answer = patiently(client, "POST", "/denoise", files={"file": content}, headers=named)
        assert answer.status_code in (200, 202), answer.text
        return str(answer.json()["id"])

    def submit(self, client: httpx.Client) -> None:
        """Take a job to its end, fetch its result, remove it."""
        job = finished(client, self._post(client, Prefer="wait=5"))
        assert job["status"] == "succeeded", job["problem"]
        assert client.get(job["links"]["result"], params={"format": self._random.choice(["ply", "npz"])}).is_success
        assert client.delete(job["links"]["self"]).status_code == 204

    def repeat(self, client: httpx.Client) -> None:
        """Send a job twice."""
        key = uuid.uuid4().hex
        self._files, files = self._files[:1], self._files
        first, second = self._post(client, Idempotency_Key=key), self._post(client, Idempotency_Key=key)
        self._files = files
        assert first == second
        assert finished(client, first)["status"] == "succeeded"

    def follow(self, client: httpx.Client) -> None:
        """Follow a job by its events, sometimes not to the end."""
        job = self._post(client)
        with client.stream("GET", f"/jobs/{job}/events") as response:
            for count, _ in enumerate(response.iter_lines()):
                if count > 20 and self._random.random() < 0.2:
                    break
        finished(client, job)

    def cancel(self, client: httpx.Client) -> None:
        """Cancel a job at some moment."""
        job = self._post(client)
        time.sleep(self._random.random() * 2)
        assert client.delete(f"/jobs/{job}").status_code in (200, 202, 204)

    def nonsense(self, client: httpx.Client) -> None:
        """Send what is refused."""
        assert client.post("/denoise", files={"file": b"ply\nnonsense"}).status_code == 422
        assert client.get("/jobs/nothing").status_code == 404
        assert client.post("/denoise", headers={"Origin": "https://example.org"}).status_code == 403


def judge(samples: list[Sample], seconds: float) -> list[str]:
    """Return what grew from the second third of the time to the last."""
    grown = []
    for name in ("supervisor", "API", "worker"):
        for column, what in ((2, "bytes"), (3, "descriptors"), (4, "threads")):
            before, after = (
                median(row[column] for row in samples if row[1] == name and low <= row[0] / seconds < low + 1 / 3)
                for low in (1 / 3, 2 / 3)
            )
            slack = {2: MEMORY_GROWTH * before + MEMORY_SLACK, 3: DESCRIPTOR_SLACK, 4: THREAD_SLACK}[column]
            print(f"{name:10} {what:12} {before:14,.0f} -> {after:14,.0f}")
            if after > before + slack:
                grown.append(f"{name}: {what} grew from {before:,.0f} to {after:,.0f}")
    return grown


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--clients", type=int, default=6)
    parser.add_argument("--pause", type=float, default=0.0, help="seconds of each client between two things it does")
    parser.add_argument("--csv", type=Path, help="where the samples go")
    options = parser.parse_args()
    samples: list[Sample] = []
    stop = threading.Event()
    with service_in(job_ttl=60, disk_budget_bytes=100_000_000) as service:
        pid = service.child("service.worker")
        paths = [write_sphere(service.log.parent / f"{n}.ply", n) for n in (2000, 8000, 40_000)]
        callers = [Caller(service, paths, stop, seed, options.pause) for seed in range(options.clients)]
        for caller in callers:
            caller.start()
        began = time.monotonic()
        while (seconds := time.monotonic() - began) < 60 * options.minutes and not any(c.error for c in callers):
            samples += sample(service, seconds)
            time.sleep(SAMPLE_SECONDS)
        stop.set()
        for caller in callers:
            caller.join(600)
        fail_unless(service.child("service.worker") == pid, "the worker was started again")
        errors = [caller.error for caller in callers if caller.error]
    if options.csv:
        with options.csv.open("w", newline="") as file:
            csv.writer(file).writerows([("seconds", "process", "bytes", "descriptors", "threads"), *samples])
    counts = sum((caller.counts for caller in callers), Counter[str]())
    print(f"{options.minutes:g} minutes, {options.clients} clients: {dict(counts)}")
    fail_unless(not errors, f"{errors}")
    grown = judge(samples, 60 * options.minutes)
    fail_unless(not grown, "; ".join(grown))


if __name__ == "__main__":
    main()
