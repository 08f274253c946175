"""Storage of uploads, tiles and results in a folder; :mod:`service.storage.s3` is the same for a bucket.

A name is a relative path such as ``jobs/<id>/upload``. Writers fill a local file of their own and hand it over with
:meth:`Storage.put`, which is atomic and durable; readers ask for a local path or for the bytes. A file that another
process might write, too, gets a name that nobody else has (:func:`own_name`), so that what was told of it stays true;
but those of which nothing is told and that come out alike whoever writes them, such as what the page draws.
"""

from __future__ import annotations

import os
import shutil
import time
import uuid
from collections.abc import Iterator
from contextlib import AbstractContextManager, nullcontext, suppress
from pathlib import Path
from typing import BinaryIO

from .base import clear, folder_bytes

PART_BYTES = 1024 * 1024


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
