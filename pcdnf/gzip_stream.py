"""A gzip stream (RFC 1952) that arrives in chunks, inflated in small pieces however much a byte inflates to."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from typing import Literal

MAGIC = b"\x1f\x8b"
PIECE_BYTES = 1 << 20
_WINDOW = 31  # of zlib: a gzip header, and the largest window

Fault = Literal["corrupt_archive", "trailing_data", "truncated"]
_WORDS: dict[Fault, str] = {
    "corrupt_archive": "it is not valid gzip data",
    "trailing_data": "other bytes follow its end",
    "truncated": "it is cut off",
}


class GzipError(Exception):
    """Data that gzip did not write.

    Attributes
    ----------
    code : {"corrupt_archive", "trailing_data", "truncated"}
    """

    def __init__(self, code: Fault) -> None:
        super().__init__(_WORDS[code])
        self.code = code


class Inflater:
    """Inflates a stream; several members in a row are one stream, as gzip itself reads them."""

    def __init__(self) -> None:
        self._inflater = zlib.decompressobj(_WINDOW)
        self._started = False

    def feed(self, chunk: bytes) -> Iterator[bytes]:
        """Yield what a chunk inflates to, in pieces of at most ``PIECE_BYTES``.

        Raises
        ------
        GzipError
        """
        while chunk:
            if self._inflater.eof:
                if not MAGIC.startswith(chunk[:2]):
                    raise GzipError("trailing_data")
                self._inflater = zlib.decompressobj(_WINDOW)
            self._started = True
            try:
                piece = self._inflater.decompress(chunk, PIECE_BYTES)
            except zlib.error as error:
                raise GzipError("corrupt_archive") from error
            if piece:
                yield piece
            chunk = self._inflater.unused_data if self._inflater.eof else self._inflater.unconsumed_tail

    def finish(self) -> None:
        """Check that the stream is at its end.

        Raises
        ------
        GzipError
            ``truncated``.
        """
        if self._started and not self._inflater.eof:
            raise GzipError("truncated")
