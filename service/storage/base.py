"""The interface of storage, and what its implementations have in common."""

from __future__ import annotations

import hashlib
import os
import secrets
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import Protocol


class StorageError(Exception):
    """The storage does not answer, or refuses a request."""


def sha256(path: Path) -> str:
    """Return the hash of a file in hex."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@contextmanager
def writing(storage: Storage, name: str) -> Iterator[Path]:
    """Yield the path of a local file to write. It is stored as `name`, or removed if the writing fails."""
    scratch = storage.scratch()
    try:
        yield scratch
        storage.put(scratch, name)
    finally:
        scratch.unlink(missing_ok=True)


def own_name(name: str) -> str:
    """Return `name` with a random part before its ending, as in ``result-1f0c2a9b.ply``."""
    stem, dot, ending = name.rpartition(".")
    return f"{stem}-{secrets.token_hex(4)}{dot}{ending}"


class Storage(Protocol):
    """The storage of the service. On another machine, every call may raise `StorageError`."""

    frees_disk: bool
    """Whether a file that is removed leaves room on the disk that :meth:`free_bytes` is about."""

    def scratch(self) -> Path:
        """Return the path of a new local file for a writer to fill; the file does not exist yet."""

    def put(self, source: Path, name: str) -> None:
        """Move `source` to `name`. After that the file survives a power failure."""

    def reading(self, name: str) -> AbstractContextManager[Path]:
        """Return a context in which `name` can be read at a local path; FileNotFoundError if it does not exist."""

    def read(self, name: str, start: int = 0, stop: int | None = None) -> Iterator[bytes]:
        """Return the bytes `start` to `stop` of `name` in parts; FileNotFoundError at once if it does not exist."""

    def size(self, name: str) -> int:
        """Return the size of `name` in bytes; FileNotFoundError if it does not exist."""

    def delete_job(self, job_id: str, *, keep: frozenset[str] = frozenset()) -> None:
        """Remove the files of a job except those in `keep`; missing files are no error."""

    def job_ids(self) -> list[str]:
        """Return the jobs that have files, and maybe some that had."""

    def idle_seconds(self, job_id: str) -> float:
        """Return the seconds since a file of the job was last written; 0 if it has none."""

    def clear_scratch(self, older_than: float) -> None:
        """Remove local files that a writer left more than `older_than` seconds ago."""

    def free_bytes(self) -> int:
        """Return the free space in bytes where files are written first."""

    def used_bytes(self) -> int:
        """Return the bytes that the files of all jobs take, and those that are being written."""

    def job_bytes(self, job_id: str) -> int:
        """Return the bytes that the files of a job take."""

    def check(self) -> None:
        """Raise `StorageError` if the storage cannot be reached."""


def folder_bytes(folder: Path) -> int:
    """Return the bytes of all files in a folder."""
    total = 0
    for path, _, names in os.walk(folder):
        for name in names:
            with suppress(FileNotFoundError):
                total += os.stat(os.path.join(path, name)).st_size
    return total


def clear(folder: Path, older_than: float) -> None:
    """Remove the files of a folder that were last written more than `older_than` seconds ago."""
    limit = time.time() - older_than
    for path in list(folder.iterdir()):
        with suppress(FileNotFoundError):
            if path.stat().st_mtime < limit:
                path.unlink()
