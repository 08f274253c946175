"""The bytes of one NPZ member, inflated piece by piece and counted against what its archive declares."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO, NoReturn

from ..errors import FormatError, shown

_CHUNK = 1 << 20


@dataclass(frozen=True)
class Member:
    """One array of an NPZ: its name without ``.npy``, and where and how its bytes lie."""

    name: str
    deflated: bool
    checksum: int
    packed: int
    size: int
    offset: int
    start: int = 0


def corrupt(what: str) -> NoReturn:
    """Raise ``corrupt_archive``."""
    raise FormatError(
        f"The NPZ contradicts itself: {what}.",
        code="corrupt_archive",
        hint="The file is damaged: copy it again, or save it again with numpy.savez.",
    )


class MemberStream:
    """The inflated bytes of a member, in order; never more than it declares."""

    def __init__(self, file: BinaryIO, member: Member) -> None:
        self._file = file
        self._member = member
        self._pieces = self._counted()
        self._held = b""

    def take(self, count: int) -> bytes:
        """Exactly ``count`` bytes; meant for headers."""
        while len(self._held) < count:
            self._held += self._next()
        taken, self._held = self._held[:count], self._held[count:]
        return taken

    def fill(self, view: memoryview) -> None:
        """Fill ``view`` with the bytes that follow."""
        position = 0
        while position < len(view):
            piece = self._held or self._next()
            part, self._held = piece[: len(view) - position], piece[len(view) - position :]
            view[position : position + len(part)] = part
            position += len(part)

    def finish(self) -> None:
        """Check that nothing is left, and the checksum."""
        if self._held or any(self._pieces):
            self._corrupt("holds more than its array")

    def _corrupt(self, what: str) -> NoReturn:
        corrupt(f"member {shown(self._member.name)} {what}")

    def _next(self) -> bytes:
        piece = next(self._pieces, None)
        if piece is None:
            self._corrupt("ends early")
        return piece

    def _counted(self) -> Iterator[bytes]:
        total = checksum = 0
        for piece in self._inflated() if self._member.deflated else self._packed():
            total += len(piece)
            checksum = zlib.crc32(piece, checksum)
            if total > self._member.size:
                self._corrupt(f"inflates to more than the {self._member.size} bytes it declares")
            yield piece
        if total != self._member.size:
            self._corrupt(f"inflates to {total} bytes and declares {self._member.size}")
        if checksum != self._member.checksum:
            self._corrupt("has another checksum than it declares")

    def _inflated(self) -> Iterator[bytes]:
        inflater = zlib.decompressobj(-zlib.MAX_WBITS)
        try:
            for data in self._packed():
                while data:
                    yield inflater.decompress(data, _CHUNK)
                    data = inflater.unconsumed_tail
                if inflater.unused_data:
                    self._corrupt("goes on after its end")
            while not inflater.eof:
                piece = inflater.decompress(b"", _CHUNK)
                if not piece:
                    self._corrupt("ends early")
                yield piece
        except zlib.error:
            self._corrupt("is not valid deflate data")

    def _packed(self) -> Iterator[bytes]:
        position, stop = self._member.start, self._member.start + self._member.packed
        while position < stop:
            self._file.seek(position)
            data = self._file.read(min(_CHUNK, stop - position))
            if not data:
                self._corrupt("ends early")
            position += len(data)
            yield data
