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
    """The storage does not answer, or refuses."""


def sha256(path: Path) -> str:
    """Return the hash of a file in hex."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@contextmanager
def writing(storage: Storage, name: str) -> Iterator[Path]:
    """Give a local file to write, which becomes `name`, or is removed where the writing fails."""
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
    """What the service asks of its storage. Where it is not on this machine every call may raise `StorageError`."""

    frees_disk: bool
    """Whether a file that is removed leaves room on the disk that :meth:`free_bytes` is about."""

    def scratch(self) -> Path:
        """Return the path of a new local file for a writer to fill; the file does not exist yet."""

    def put(self, source: Path, name: str) -> None:
        """Take `source` over as `name`. When this returns, the file survives a power loss."""

    def reading(self, name: str) -> AbstractContextManager[Path]:
        """Return a context in which `name` can be read at a local path; FileNotFoundError where it is not there."""

    def read(self, name: str, start: int = 0, stop: int | None = None) -> Iterator[bytes]:
        """Return the bytes `start` to `stop` of `name` in parts; FileNotFoundError, at once, where it is not there."""

    def size(self, name: str) -> int:
        """Return the bytes of `name`; FileNotFoundError where it is not there."""

    def delete_job(self, job_id: str, *, keep: frozenset[str] = frozenset()) -> None:
        """Remove the files of a job but those in `keep`; files that are not there are no error."""

    def job_ids(self) -> list[str]:
        """Return the jobs that have files, and maybe some that had."""

    def idle_seconds(self, job_id: str) -> float:
        """Return for how long no file of a job was written; 0 where it has none."""

    def clear_scratch(self, older_than: float) -> None:
        """Remove local files that a writer left more than `older_than` seconds ago."""

    def free_bytes(self) -> int:
        """Return the free space in bytes where files are written first."""

    def used_bytes(self) -> int:
        """Return the bytes that the files of all jobs take, and those that are being written."""

    def job_bytes(self, job_id: str) -> int:
        """Return the bytes that the files of a job take."""

    def check(self) -> None:
        """Raise `StorageError` where it cannot be reached."""


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
