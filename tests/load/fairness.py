"""A small job behind a large one: ``python -m tests.load.fairness [--small 5000] [--large 1000000]``."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from tests.support.load import Service, fail_unless, finished, service_in, write_sphere


def seconds_of(service: Service, path: Path) -> float:
    """Return how long a job takes from its upload to its end."""
    began = time.monotonic()
    job = finished(service.client, service.submit(path, iterations=2)["id"])
    fail_unless(job["status"] == "succeeded", f"the small job ended as {job['status']}")
    return time.monotonic() - began


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--small", type=int, default=5000)
    parser.add_argument("--large", type=int, default=1_000_000)
    parser.add_argument("--times", type=int, default=3)
    options = parser.parse_args()
    with service_in() as service:
        folder = service.log.parent
        small = write_sphere(folder / "small.ply", options.small)
        alone = min(seconds_of(service, small) for _ in range(options.times))
        large = service.submit(write_sphere(folder / "large.ply", options.large), iterations=2)["id"]
        service.wait_status(large, "running")
        preparing = seconds_of(service, small)
        done = service.wait_done(large, 16_384, seconds=600)
        tile = 16_384 / done["points_per_second"]
        beside = [seconds_of(service, small) for _ in range(options.times)]
        status = service.job(large)["status"]
        service.client.delete(f"/jobs/{large}")
        finished(service.client, large)
    shown = ", ".join(f"{each:.1f}" for each in beside)
    print(f"{options.small} points alone: {alone:.1f} s; while {options.large} are prepared: {preparing:.1f} s")
    print(f"beside them: {shown} s; a tile of theirs: {tile:.1f} s")
    bar = 3 * alone
    fail_unless(status == "running", "the large job had ended, take a larger one")
    fail_unless(max(*beside, preparing) <= bar, f"more than {bar:.1f} s")


if __name__ == "__main__":
    main()
