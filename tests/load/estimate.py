"""How near a job's `seconds_left` is: ``python -m tests.load.estimate [--points 60000] [--iterations 2]``.

Asks several times a second and compares, once the job has ended. After a tenth of the work an estimate should be right
within a third; the last two seconds are left out, and so is one sample in twenty.
"""

from __future__ import annotations

import argparse
import time

from tests.support.load import fail_unless, service_in, write_sphere

ENOUGH, NEAR, LAST_SECONDS, SHARE = 0.1, 1 / 3, 2.0, 0.95


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=60_000)
    parser.add_argument("--iterations", type=int, default=2)
    parser.add_argument("--threads", type=int, default=0, help="of the worker; 0 for all")
    parser.add_argument("--every", action="store_true", help="show every sample")
    options = parser.parse_args()
    seen = []
    with service_in(threads=options.threads) as service:
        path = write_sphere(service.log.parent / "sphere.ply", options.points)
        for _ in range(2):  # before the first job nothing is known of the speed
            job = service.submit(path, iterations=options.iterations)
            samples = []
            while job["status"] not in ("succeeded", "failed", "cancelled"):
                time.sleep(0.2)
                job = service.job(job["id"])
                samples.append((time.monotonic(), job))
            fail_unless(job["status"] == "succeeded", f"the job ended as {job['status']}")
            end = samples[-1][0]
            seen.append([(end - at, shown) for at, shown in samples if shown["status"] == "running"])
    for samples in seen:
        errors = []
        for left, shown in samples:
            share = shown["progress"]["done"] / shown["progress"]["total"]
            told, speed = shown["seconds_left"], shown["points_per_second"]
            if options.every:
                print(f"{share:6.1%} done, {left:5.1f} s left, told {told}, {speed} points/s")
            if share >= ENOUGH and left > LAST_SECONDS:
                fail_unless(told is not None and speed is not None, f"nothing is told at {share:.1%}")
                errors.append(told / left - 1)
        near = sum(abs(error) <= NEAR for error in errors) / max(len(errors), 1)
        print(f"{len(errors)} samples, from {min(errors):+.0%} to {max(errors):+.0%}, within a third: {near:.0%}")
        fail_unless(near >= SHARE, "too few estimates were near")


if __name__ == "__main__":
    main()
