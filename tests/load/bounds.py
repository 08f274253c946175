"""A full queue is exact: ``python -m tests.load.bounds [--uploads 50] [--room 20]``."""

from __future__ import annotations

import argparse
from collections import Counter
from concurrent.futures import ThreadPoolExecutor

import httpx

from tests.support.load import fail_unless, service_in, write_sphere

POINTS = 2000


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--uploads", type=int, default=50)
    parser.add_argument("--room", type=int, default=20)
    options = parser.parse_args()
    bound = options.room * POINTS + POINTS // 2
    # No worker looks at the queue during the test.
    with service_in(max_queued_points=bound, poll_seconds=3600) as service:
        content = write_sphere(service.log.parent / "small.ply", POINTS).read_bytes()

        def upload(_: int) -> httpx.Response:
            url = str(service.client.base_url.join("/denoise"))
            return httpx.post(url, files={"file": content}, params={"iterations": 1}, timeout=300, trust_env=False)

        with ThreadPoolExecutor(options.uploads) as pool:
            answers = list(pool.map(upload, range(options.uploads)))
        codes = Counter(answer.json().get("code", answer.status_code) for answer in answers)
        listed = service.client.get("/jobs", params={"limit": 100}).json()
        live = sum(job["progress"]["total"] for job in listed if job["status"] in ("queued", "running"))
    print(f"{options.uploads} uploads at once, room for {options.room}: {dict(codes)}; {live} of {bound} points queued")
    expected = {202: options.room, "queue_full": options.uploads - options.room}
    fail_unless(dict(codes) == expected, f"expected {expected}")
    fail_unless(all("retry-after" in answer.headers for answer in answers), "an answer lacks Retry-After")


if __name__ == "__main__":
    main()
