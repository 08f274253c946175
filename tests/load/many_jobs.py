"""Many small jobs from many clients, none lost: ``python -m tests.load.many_jobs [--jobs 200] [--clients 50]``."""

from __future__ import annotations

import argparse
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from statistics import median, quantiles
from typing import Any

import httpx

from tests.support.load import Service, fail_unless, finished, patiently, service_in, write_sphere


def client_of(service: Service, path: Path, jobs: int) -> list[tuple[dict[str, Any], float, int]]:
    """Send so many jobs one after the other; return each with its seconds and the bytes of its result."""
    done = []
    content = path.read_bytes()
    with httpx.Client(base_url=service.client.base_url, timeout=120, trust_env=False) as client:
        for _ in range(jobs):
            began = time.monotonic()
            answer = patiently(client, "POST", "/denoise", files={"file": content}, params={"iterations": 1})
            fail_unless(answer.status_code == 202, f"an upload was answered {answer.status_code}: {answer.text}")
            job = finished(client, answer.json()["id"], pause=2.0)  # as Retry-After asks for
            size = len(client.get(f"/jobs/{job['id']}/result").content)
            done.append((job, time.monotonic() - began, size))
    return done


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--jobs", type=int, default=200)
    parser.add_argument("--clients", type=int, default=50)
    parser.add_argument("--points", type=int, default=2000)
    options = parser.parse_args()
    share = [options.jobs // options.clients + (n < options.jobs % options.clients) for n in range(options.clients)]
    with service_in() as service, ThreadPoolExecutor(options.clients) as pool:
        path = write_sphere(service.log.parent / "small.ply", options.points)
        began = time.monotonic()
        answers = pool.map(lambda jobs: client_of(service, path, jobs), share)
        done = [each for client in answers for each in client]
        seconds = time.monotonic() - began
        log = service.output()
    statuses = Counter(job["status"] for job, _, _ in done)
    ids = {job["id"] for job, _, _ in done}
    waits = sorted(wait for _, wait, _ in done)
    print(f"{len(done)} jobs of {options.points} points from {options.clients} clients in {seconds:.1f} s: "
          f"{len(done) / seconds:.2f} a second; {dict(statuses)}")  # fmt: skip
    print(f"seconds a job: median {median(waits):.1f}, 95 % {quantiles(waits, n=20)[-1]:.1f}, longest {waits[-1]:.1f}")
    fail_unless(len(ids) == options.jobs, f"{options.jobs - len(ids)} jobs were lost")
    fail_unless(set(statuses) == {"succeeded"}, f"not every job succeeded: {dict(statuses)}")
    fail_unless(min(size for _, _, size in done) > 12 * options.points, "a result is too short")
    twice = [job for job in ids if log.count(f"job {job} succeeded") != 1]
    fail_unless(not twice, f"{len(twice)} jobs ran twice")


if __name__ == "__main__":
    main()
