"""The results of a batch as one zip archive, written while it is sent."""

from __future__ import annotations

import io
import json
import time
import zipfile
from collections.abc import Iterator, Sequence

from ...jobs.files import result_file
from ...jobs.job import Job
from ...storage.base import Storage

PROBLEMS = "problems.json"
"""The member that says why jobs have no result."""


class _Pipe(io.RawIOBase):
    """A file that cannot seek; what was written is taken piece by piece."""

    def __init__(self) -> None:
        self._pieces: list[bytes] = []

    def writable(self) -> bool:
        return True

    def write(self, data: bytes) -> int:  # type: ignore[override]
        self._pieces.append(bytes(data))
        return len(data)

    def take(self) -> bytes:
        taken, self._pieces = b"".join(self._pieces), []
        return taken


def archive(jobs: Sequence[Job], storage: Storage) -> Iterator[bytes]:
    """Yield a zip archive with the result of each job in the format of its upload, and the problems of the others.

    Results are stored as they are: they hardly shrink.

    Raises
    ------
    FileNotFoundError
        If a result was removed in the meantime.
    """
    pipe = _Pipe()
    with zipfile.ZipFile(pipe, "w") as packed:
        problems = {}
        for name, job in _names(jobs).items():
            if job.status != "succeeded":
                problems[name] = job.problem or {"code": f"job_{job.status}", "detail": f"The job was {job.status}."}
                continue
            member = zipfile.ZipInfo(name, time.gmtime((job.finished_at or 0) / 1000)[:6])
            with packed.open(member, "w", force_zip64=True) as file:
                for part in storage.read(result_file(job, job.upload["format"])):
                    file.write(part)
                    yield pipe.take()
        if problems:
            packed.writestr(PROBLEMS, json.dumps(problems, indent=1))
    yield pipe.take()


def _names(jobs: Sequence[Job]) -> dict[str, Job]:
    """Return the jobs by the names of their results, each of which occurs once."""
    named: dict[str, Job] = {}
    for job in jobs:
        stem, ending = f"{job.upload['name']}_denoised", job.upload["format"]
        name, count = f"{stem}.{ending}", 1
        while name in named:
            count += 1
            name = f"{stem}_{count}.{ending}"
        named[name] = job
    return named
