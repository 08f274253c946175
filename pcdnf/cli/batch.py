"""Several files through a service: up to four jobs run while the results are fetched in order."""

from __future__ import annotations

import glob
import re
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..client.client import Client, format_of
from ..client.schemas import Job
from ..errors import PcdnfError
from .progress import Display

AHEAD = 4
"""Jobs on the service at a time: enough to keep its worker busy, few enough to leave the queue to others."""
HOPELESS = frozenset({"unreachable", "not_authenticated", "bad_certificate"})
"""Errors that would also stop the next file."""


@dataclass
class Item:
    """A file or an earlier job, and its outcome.

    Attributes
    ----------
    name : str
        Shown to the user.
    source : Path or None
        None for an earlier job.
    job : Job or None
        Its last known state.
    output : Path or None
        Set once it is written.
    error : PcdnfError or None
    """

    name: str
    source: Path | None = None
    job_id: str | None = None
    job: Job | None = None
    output: Path | None = None
    error: PcdnfError | None = None

    @property
    def state(self) -> str:
        """The job's status; ``done`` once the result is written, ``failed`` after an error."""
        if self.error is not None:
            return "failed"
        if self.output is not None:
            return "done"
        return "not submitted" if self.job is None else self.job.status

    def as_dict(self) -> dict[str, Any]:
        """Return the object that ``--json`` prints."""
        job, error = self.job, self.error
        return {
            "file": None if self.source is None else str(self.source),
            "job": self.job_id,
            "state": self.state,
            "output": None if self.output is None else str(self.output),
            "points": None if job is None else job.upload.get("points"),
            "seconds": seconds(job),
            "warnings": [] if job is None else job.warnings,
            "error": None if error is None else {"code": error.code, "detail": str(error), "hint": error.hint},
        }


def seconds(job: Job | None) -> float | None:
    """Run time of a finished job, in seconds."""
    if job is None or job.started_at is None or job.finished_at is None:
        return None
    return (job.finished_at - job.started_at).total_seconds()


@dataclass
class Destination:
    """Where results go: one file, or a folder for any number.

    Attributes
    ----------
    file, folder : Path or None
        Exactly one of them.
    """

    file: Path | None
    folder: Path | None
    _taken: set[str] = field(default_factory=set, init=False, repr=False)

    def check(self, items: Sequence[Item]) -> None:
        """Raise before the work starts if a result could not be written."""
        if self.file is not None:
            if len(items) > 1:
                raise PcdnfError(
                    f"{len(items)} results cannot be written to one file.",
                    code="one_output",
                    hint="Use --out-folder FOLDER instead of -o.",
                )
            if self.file.is_dir() or not self.file.parent.is_dir():
                what = "it is a folder" if self.file.is_dir() else "its folder does not exist"
                raise PcdnfError(
                    f"{self.file} cannot be written: {what}.",
                    code="unwritable_file",
                    hint="Name a file in an existing folder, or use --out-folder.",
                )
            return
        assert self.folder is not None
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise PcdnfError(
                f"The folder {self.folder} cannot be created: {error.strerror}.",
                code="unwritable_file",
                hint="Choose another folder.",
            ) from error
        names: dict[str, Path] = {}
        for source in (item.source for item in items if item.source is not None):
            other = names.setdefault(_result_name(source), source)
            if other != source:
                raise PcdnfError(
                    f"{other} and {source} would both be written to {_result_name(source)}.",
                    code="same_name",
                    hint="Submit them separately, into different folders.",
                )
        self._taken.update(names)

    def of(self, item: Item, job: Job) -> tuple[Path, str | None]:
        """Path and format of a result; None is the format that was uploaded."""
        if self.file is not None:
            return self.file, format_of(self.file, item.source)
        assert self.folder is not None
        if item.source is not None:
            return self.folder / _result_name(item.source), None
        # The service supplies the name of an earlier job: it must not leave the folder, and may repeat.
        name = re.split(r"[/\\\0]", f"{job.upload['name']}_denoised.{job.upload['format']}")[-1]
        return self.folder / self._free(name), None

    def _free(self, name: str) -> str:
        stem, dot, ending = name.rpartition(".")
        number, free = 1, name
        while free in self._taken:
            number += 1
            free = f"{stem}_{number}{dot}{ending}"
        self._taken.add(free)
        return free


def _result_name(source: Path) -> str:
    return f"{source.stem}_denoised{source.suffix}"


@dataclass
class Batch:
    """Files through a service.

    Attributes
    ----------
    client : Client
    display : Display
    parameters : dict
        Of the jobs.
    report : callable
        Called with every finished item, in order.
    """

    client: Client
    display: Display
    parameters: dict[str, str]
    report: Callable[[Item], None]
    under_way: deque[Item] = field(default_factory=deque)
    """Items whose job is on the service and whose result is not fetched yet."""
    uploading: Item | None = None
    """The item that is being sent; after an interrupt it is unknown whether the service received it."""

    def submit(self, items: Iterable[Item]) -> None:
        """Upload all items without waiting for their jobs."""
        hopeless: PcdnfError | None = None
        for item in items:
            hopeless = self._upload(item, hopeless)
            self.report(item)

    def run(self, items: Iterable[Item], destination: Destination) -> None:
        """Upload the items, wait for their jobs and fetch the results."""
        hopeless: PcdnfError | None = None
        for item in items:
            while len(self.under_way) >= AHEAD:
                hopeless = self._finish(destination) or hopeless
            hopeless = self._upload(item, hopeless)
            if item.error is None:
                self.under_way.append(item)
            else:
                self.report(item)
        while self.under_way:
            self._finish(destination)

    def _upload(self, item: Item, hopeless: PcdnfError | None) -> PcdnfError | None:
        """Submit an item unless it has a job already; return an error that would stop the others as well."""
        try:
            if hopeless is not None:
                raise hopeless
            if item.source is not None:

                def progress(done: int, total: int) -> None:
                    self.display.upload(item.name, done, total)

                self.uploading = item
                item.job = self.client.submit(item.source, self.parameters, progress=progress)
                item.job_id = item.job.id
                self.uploading = None
        except PcdnfError as error:
            item.error, self.uploading = error, None
        finally:
            self.display.clear()
        return item.error if item.error is not None and item.error.code in HOPELESS else None

    def _finish(self, destination: Destination) -> PcdnfError | None:
        """Wait for the oldest job, fetch its result, and report it."""
        item = self.under_way[0]
        assert item.job_id is not None

        def progress(job: Job) -> None:
            item.job = job
            self.display.job(item.name, job)

        try:
            job = self.client.wait(item.job_id, progress=progress)
            self.client.succeeded(job)
            path, format_ = destination.of(item, job)
            self.client.result(job.id, path, format=format_)
            item.output = path
        except PcdnfError as error:
            item.error = error
        finally:
            self.display.clear()
        self.under_way.popleft()
        self.report(item)
        return item.error if item.error is not None and item.error.code in HOPELESS else None


def expanded(patterns: Sequence[str]) -> list[Path]:
    """Expand names and patterns that the shell did not expand: each file once, in order.

    Raises
    ------
    PcdnfError
        ``no_files`` for one that names nothing.
    """
    found: dict[Path, None] = {}
    for pattern in patterns:
        path = Path(pattern)
        matches = [path] if path.is_file() else [Path(m) for m in sorted(glob.glob(pattern, recursive=True))]
        files = [match for match in matches if match.is_file()]
        if not files:
            raise PcdnfError(
                f"{pattern} is a folder." if path.is_dir() else f"There is no file {pattern}.",
                code="no_files",
                hint=f"Name its files: '{pattern.rstrip('/')}/*.ply'." if path.is_dir() else "Check the name.",
            )
        found |= dict.fromkeys(files)
    return list(found)
