"""Where uploads, tiles and results lie: one interface, a folder here, a bucket in :mod:`service.bucket`.

A name is a relative path such as ``jobs/<id>/upload``. Writers fill a local file of their own and hand it over with
:meth:`Storage.put`, which is atomic and durable; readers ask for a local path or for the bytes. A file that another
process might write, too, gets a name that nobody else has (:func:`own_name`), so that what was told of it stays true;
but those of which nothing is told and that come out alike whoever writes them, such as what the page draws.
"""

from __future__ import annotations

import hashlib
import os
import secrets
import shutil
import time
import uuid
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any, BinaryIO, Protocol
from urllib.parse import unquote, urlsplit

from .job import Job
from .settings import Settings, SettingsError

UPLOAD = "upload"
DISPLAY = "display.glb"
PART_BYTES = 1024 * 1024


class StorageError(Exception):
    """The storage does not answer, or refuses."""


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


def own_name(name: str) -> str:
    """Return `name` with a random part before its ending, as in ``result-1f0c2a9b.ply``."""
    stem, dot, ending = name.rpartition(".")
    return f"{stem}-{secrets.token_hex(4)}{dot}{ending}"


def result_facts(path: Path, name: str) -> dict[str, Any]:
    """Return what the row of a job tells of a result that `path` holds and that is to be stored as `name`."""
    return {"file": name, "size": path.stat().st_size, "sha256": sha256(path)}


def result_name(format_: str, facts: dict[str, Any]) -> str:
    """Return under which name of the job a result is stored."""
    name: str = facts.get("file", f"result.{format_}")  # as older versions named it
    return name


def result_file(job: Job, format_: str) -> str:
    """Return the name in storage of a result that `job` has."""
    assert job.results is not None
    return job_file(job.id, result_name(format_, job.results[format_]))


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


def open_storage(settings: Settings, *, patience: float) -> Storage:
    """Return the storage in the settings; :meth:`Storage.check` tells whether it can be reached.

    Parameters
    ----------
    settings : Settings
    patience : float
        Seconds that a request to a storage elsewhere is tried again.

    Raises
    ------
    SettingsError
        If there can be no such storage.
    """
    url = settings.storage_url or settings.data_dir.absolute().as_uri()
    try:
        if url.startswith("file:"):
            return LocalStorage(Path(unquote(urlsplit(url).path)))
        from .bucket import BucketStorage  # only where one is used

        return BucketStorage(url, settings.data_dir, patience=patience)
    except (StorageError, OSError) as error:
        raise SettingsError(f"{url} cannot be used for storage: {error}") from error


class LocalStorage:
    """A folder, on a local disk or one that several machines share.

    Parameters
    ----------
    root : Path
        The folder; made when missing.
    """

    frees_disk = True

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
        target = self._root / name
        fresh = not target.parent.exists()
        target.parent.mkdir(parents=True, exist_ok=True)
        _sync(source)
        os.replace(source, target)
        _sync(target.parent)
        if fresh:
            _sync(target.parent.parent)

    def reading(self, name: str) -> AbstractContextManager[Path]:
        """See :class:`Storage`."""
        self.size(name)
        return nullcontext(self._root / name)

    def read(self, name: str, start: int = 0, stop: int | None = None) -> Iterator[bytes]:
        """See :class:`Storage`."""
        return _parts((self._root / name).open("rb"), start, stop)

    def size(self, name: str) -> int:
        """See :class:`Storage`."""
        return (self._root / name).stat().st_size

    def delete_job(self, job_id: str, *, keep: frozenset[str] = frozenset()) -> None:
        """See :class:`Storage`."""
        folder = self._root / "jobs" / job_id
        if not keep:
            shutil.rmtree(folder, ignore_errors=True)
            return
        for path in folder.iterdir() if folder.exists() else ():
            if path.name not in keep:
                shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)

    def job_ids(self) -> list[str]:
        """See :class:`Storage`."""
        return os.listdir(self._root / "jobs")

    def idle_seconds(self, job_id: str) -> float:
        """See :class:`Storage`."""
        with suppress(FileNotFoundError):
            return time.time() - (self._root / "jobs" / job_id).stat().st_mtime
        return 0.0

    def clear_scratch(self, older_than: float) -> None:
        """See :class:`Storage`."""
        clear(self._scratch, older_than)

    def free_bytes(self) -> int:
        """See :class:`Storage`."""
        return shutil.disk_usage(self._root).free

    def used_bytes(self) -> int:
        """See :class:`Storage`."""
        return folder_bytes(self._root / "jobs") + folder_bytes(self._scratch)

    def job_bytes(self, job_id: str) -> int:
        """See :class:`Storage`."""
        return folder_bytes(self._root / "jobs" / job_id)

    def check(self) -> None:
        """See :class:`Storage`."""


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


def _parts(file: BinaryIO, start: int, stop: int | None) -> Iterator[bytes]:
    with file:
        file.seek(start)
        left = os.fstat(file.fileno()).st_size - start if stop is None else stop - start
        while left > 0 and (part := file.read(min(left, PART_BYTES))):
            left -= len(part)
            yield part


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
