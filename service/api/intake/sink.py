"""Where a file goes that arrives: counted, hashed and written in large pieces, off the event loop."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from starlette.concurrency import run_in_threadpool

from ...problems import Problem
from ...settings import MIB

WRITE_BYTES = MIB  # written to disk at a time


class Tally:
    """The bytes of all files of a request, and the most that are accepted.

    Parameters
    ----------
    limit : int
    """

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.size = 0

    def add(self, count: int) -> None:
        """Count further bytes.

        Raises
        ------
        Problem
            413 ``upload_too_large``.
        """
        self.size += count
        if self.size > self.limit:
            raise too_large(self.limit, self.size)


class Sink:
    """A file that is being received.

    Parameters
    ----------
    path : Path
        Created.
    tally : Tally

    Attributes
    ----------
    size : int
    file_name, content_type : str
        As the caller names them; a name is never used as a path.
    """

    def __init__(self, path: Path, tally: Tally) -> None:
        self.path = path
        self._descriptor = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666)
        self._tally = tally
        self._buffer = bytearray()
        self._hash = hashlib.sha256()
        self.size = 0
        self.file_name = ""
        self.content_type = ""

    def add(self, data: bytes) -> None:
        """Take bytes; they are written by :meth:`flush`."""
        self.size += len(data)
        self._tally.add(len(data))
        self._buffer += data

    async def flush(self, *, everything: bool = False) -> None:
        """Write what has come, if it is much."""
        if self._buffer and (everything or len(self._buffer) >= WRITE_BYTES):
            data, self._buffer = self._buffer, bytearray()
            await run_in_threadpool(self._write, data)

    def close(self) -> None:
        """Close the file; a second call does nothing."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1

    @property
    def sha256(self) -> str:
        """The hash in hex of what was written."""
        return self._hash.hexdigest()

    def _write(self, data: bytearray) -> None:
        self._hash.update(data)
        view = memoryview(data)
        while view:
            view = view[os.write(self._descriptor, view) :]


def too_large(limit: int, actual: int) -> Problem:
    """Return the problem for an upload over the limit."""
    return Problem(
        "upload_too_large",
        f"The upload is larger than {limit} bytes, the limit of this service.",
        hint="Send a smaller cloud, or a binary file instead of text.",
        limit=limit,
        actual=actual,
    )
