"""Where uploads, tiles and results lie: one interface, a local folder now.

A name is a relative path such as ``jobs/<id>/upload``. Writers fill a local file of their own and hand it over with
:meth:`Storage.put`, which is atomic and durable; readers ask for a local path. A bucket fits behind the same calls.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Protocol

UPLOAD = "upload"
DISPLAY = "display.glb"


def sha256(path: Path) -> str:
    """Return the hash of a file in hex."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def job_file(job_id: str, name: str) -> str:
    """Return the name in storage of one file of a job."""
    return f"jobs/{job_id}/{name}"


@contextmanager
def writing(storage: Storage, name: str) -> Iterator[Path]:
    """Give a local file to write, which becomes `name`, or is removed where the writing fails."""
    scratch = storage.scratch()
    try:
        yield scratch
        storage.put(scratch, name)
    finally:
        scratch.unlink(missing_ok=True)


class Storage(Protocol):
    """What the service asks of its storage."""

    def scratch(self) -> Path:
        """Return the path of a new local file for a writer to fill; the file does not exist yet."""

    def put(self, source: Path, name: str) -> None:
        """Take `source` over as `name`. When this returns, the file survives a power loss."""

    def local(self, name: str) -> Path:
        """Return a local path to read `name` from; it may not exist."""

    def delete_job(self, job_id: str, *, keep: frozenset[str] = frozenset()) -> None:
        """Remove the files of a job but those in `keep`; files that are not there are no error."""

    def job_ids(self, older_than: float) -> Iterator[str]:
        """Yield the jobs that have files and were last touched more than `older_than` seconds ago."""

    def clear_scratch(self, older_than: float) -> None:
        """Remove local files that a writer left more than `older_than` seconds ago."""

    def free_bytes(self) -> int:
        """Return the free space in bytes."""

    def used_bytes(self) -> int:
        """Return the bytes that the files of all jobs take, and those that are being written."""

    def job_bytes(self, job_id: str) -> int:
        """Return the bytes that the files of a job take."""


class LocalStorage:
    """A folder on a local disk.

    Parameters
    ----------
    root : Path
        The folder; made when missing.
    """

    def __init__(self, root: Path) -> None:
        self._root = root
        self._scratch = root / "scratch"
        (root / "jobs").mkdir(parents=True, exist_ok=True)
        self._scratch.mkdir(exist_ok=True)

    def scratch(self) -> Path:
        """See :class:`Storage`."""
        return self._scratch / uuid.uuid4().hex

    def put(self, source: Path, name: str) -> None:
        """See :class:`Storage`."""
        target = self.local(name)
        fresh = not target.parent.exists()
        target.parent.mkdir(parents=True, exist_ok=True)
        _sync(source)
        os.replace(source, target)
        _sync(target.parent)
        if fresh:
            _sync(target.parent.parent)

    def local(self, name: str) -> Path:
        """See :class:`Storage`."""
        return self._root / name

    def delete_job(self, job_id: str, *, keep: frozenset[str] = frozenset()) -> None:
        """See :class:`Storage`."""
        folder = self._root / "jobs" / job_id
        if not keep:
            shutil.rmtree(folder, ignore_errors=True)
            return
        for path in folder.iterdir() if folder.exists() else ():
            if path.name not in keep:
                shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)

    def job_ids(self, older_than: float) -> Iterator[str]:
        """See :class:`Storage`."""
        for path in _older(self._root / "jobs", older_than):
            yield path.name

    def clear_scratch(self, older_than: float) -> None:
        """See :class:`Storage`."""
        for path in _older(self._scratch, older_than):
            path.unlink(missing_ok=True)

    def free_bytes(self) -> int:
        """See :class:`Storage`."""
        return shutil.disk_usage(self._root).free

    def used_bytes(self) -> int:
        """See :class:`Storage`."""
        return _size(self._root / "jobs") + _size(self._scratch)

    def job_bytes(self, job_id: str) -> int:
        """See :class:`Storage`."""
        return _size(self._root / "jobs" / job_id)


def _size(folder: Path) -> int:
    total = 0
    for path, _, names in os.walk(folder):
        for name in names:
            with suppress(FileNotFoundError):
                total += os.stat(os.path.join(path, name)).st_size
    return total


def _older(folder: Path, seconds: float) -> Iterator[Path]:
    limit = time.time() - seconds
    for path in list(folder.iterdir()):
        try:
            if path.stat().st_mtime < limit:
                yield path
        except FileNotFoundError:
            continue


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
