"""Uploads that report their progress, and downloads that can be resumed and are checked."""

from __future__ import annotations

import base64
import binascii
import hashlib
import os
import re
from collections.abc import Callable
from typing import BinaryIO

import httpx

from ..errors import PcdnfError

BytesDone = Callable[[int, int], None]
"""Called with the bytes done and the total."""
_DIGEST = re.compile(r"sha-256=:([A-Za-z0-9+/=]+):")
_RANGE = re.compile(r"bytes (\d+)-")


class CountedFile:
    """A file that is uploaded in pieces and reports how much of it was read."""

    def __init__(self, file: BinaryIO, progress: BytesDone | None) -> None:
        self._file = file
        self._size = os.fstat(file.fileno()).st_size
        self._progress = progress

    def fileno(self) -> int:
        """Return the descriptor, from which httpx takes the length."""
        return self._file.fileno()

    def seek(self, offset: int) -> int:
        """Move to an offset, to repeat the upload."""
        return self._file.seek(offset)

    def read(self, size: int = -1) -> bytes:
        """Return the next bytes."""
        data = self._file.read(size)
        if self._progress:
            self._progress(self._file.tell(), self._size)
        return data


class Download:
    """A result that is written to a file, over several connections if one breaks.

    Parameters
    ----------
    file : binary file
        Open for writing, empty.
    progress : callable, optional
    """

    def __init__(self, file: BinaryIO, progress: BytesDone | None) -> None:
        self._file = file
        self._progress = progress
        self._hash = hashlib.sha256()
        self._done = 0
        self._etag: str | None = None
        self._digest: bytes | None = None

    @property
    def headers(self) -> dict[str, str]:
        """Headers of the next request: only the missing bytes, if the result is still the same."""
        if self._done == 0 or self._etag is None:
            return {}
        return {"Range": f"bytes={self._done}-", "If-Range": self._etag}

    def take(self, response: httpx.Response) -> None:
        """Write the body of a response, which has status 200 or 206."""
        found = _RANGE.match(response.headers.get("content-range", ""))
        if response.status_code != 206 or found is None or int(found[1]) != self._done:
            self._file.seek(0)
            self._file.truncate()
            self._hash, self._done = hashlib.sha256(), 0
        self._etag = response.headers.get("etag")
        self._digest = _digest(response.headers.get("repr-digest", ""))
        total = self._done + int(response.headers.get("content-length", 0))
        for data in response.iter_raw():
            self._file.write(data)
            self._hash.update(data)
            self._done += len(data)
            if self._progress:
                self._progress(self._done, max(total, self._done))

    def check(self) -> None:
        """Compare the written bytes with the service's digest.

        Raises
        ------
        PcdnfError
            ``digest_mismatch``
        """
        if self._digest is not None and self._digest != self._hash.digest():
            raise PcdnfError(
                "The downloaded result is damaged: its SHA-256 differs from the one that the service reports.",
                code="digest_mismatch",
                hint="Download it again. If this repeats, a proxy in front of the service may alter it.",
            )


def _digest(header: str) -> bytes | None:
    """Return the SHA-256 of an RFC 9530 header, or None."""
    found = _DIGEST.search(header)
    try:
        return base64.b64decode(found[1], validate=True) if found else None
    except binascii.Error:
        return None
