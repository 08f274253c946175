"""One cloud through the service, step by step, with the Python client.

python examples/python_client.py scan.ply clean.ply [http://127.0.0.1:8000]
"""

from __future__ import annotations

import sys

from pcdnf.client import Client, Job, JobError, ProblemError, UnreachableError


def show(job: Job) -> None:
    """Say how far a job is."""
    if job.status == "queued":
        print(f"position {job.queue_position} in the queue")
    else:
        left = "" if job.seconds_left is None else f", {job.seconds_left:.0f} s left"
        print(f"{job.status}: {job.progress.done / job.progress.total:.0%}{left}")


def main() -> None:
    """Submit, follow, fetch."""
    source, target = sys.argv[1:3]
    address = sys.argv[3] if len(sys.argv) > 3 else None
    try:
        with Client(address) as client:
            job = client.submit(source, {"iterations": 2})
            job = client.wait(job.id, progress=show)
            client.succeeded(job)
            client.result(job.id, target)
    except JobError as error:
        raise SystemExit(f"Job {error.job_id}: {error} {error.hint or ''}") from error
    except (ProblemError, UnreachableError) as error:
        raise SystemExit(f"{error} {error.hint or ''}") from error
    print(f"{job.upload['points']} points, {job.parameters['model']}: {target}")


if __name__ == "__main__":
    main()
