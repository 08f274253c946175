"""The body of an ASCII PLY: whole lines are taken in blocks and parsed by numpy's C reader."""

from __future__ import annotations

import io
from collections.abc import Iterator
from itertools import chain
from typing import Any, BinaryIO, NoReturn

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError, shown
from .elements import Element

MAX_TOKEN_BYTES = 64
MAX_TEXT_LINE_BYTES = 16 * 1024**2
"""A line of a list element may be long; beyond this it is not text written by a mesh tool."""

_BLOCK_BYTES = 4 * 1024**2
_ROWS_PER_WRITE = 1 << 16
_IS_TOKEN = np.ones(256, bool)
_IS_TOKEN[[9, 10, 11, 12, 13, 32]] = False


class TextBody:
    """Rows of an open ASCII body, one a line; blank lines are passed over.

    Parameters
    ----------
    file : binary file
        Open at the first byte of the body.
    newline : bytes
        What ends a line.
    """

    def __init__(self, file: BinaryIO, newline: bytes = b"\n") -> None:
        self._file = file
        self._newline = newline
        self._block = b""
        self._position = 0  # in the block
        self._ends = np.empty(0, np.int64)  # where each row of the block ends
        self._counts = np.empty(0, np.int64)  # its number of values
        self._row = 0  # next row of the block
        self._rest = b""

    def read(self, element: Element) -> NDArray[np.void]:
        """Read the rows of an element in native byte order, and skip its lists.

        Raises
        ------
        FormatError
            ``truncated`` or ``bad_value``.
        """
        rows = np.empty(element.count, element.row_dtype("="))
        done = 0
        for text, counts in self._take(element):
            if element.has_list:
                text = _without_lists(text, element, done)
                counts = np.full(len(counts), len(element.scalars))
            wrong = np.flatnonzero(counts != len(element.scalars))
            if wrong.size:
                raise FormatError(
                    f"Row {done + wrong[0]} of element {shown(element.name)} has {counts[wrong[0]]} values; "
                    f"the header declares {len(element.scalars)}.",
                    code="bad_value",
                    hint="Write one line of numbers a point, in the order of the properties.",
                    limit=len(element.scalars),
                    actual=int(counts[wrong[0]]),
                )
            stop = done + len(counts)
            _convert(_parse(text, len(counts), element, done), rows[done:stop], element, done)
            done = stop
        return rows

    def skip(self, element: Element) -> bytes:
        """Pass over the rows of an element, whatever they hold; the text they are."""
        return b"".join(text for text, _ in self._take(element))

    def rewind(self) -> None:
        """Put the file back to the first byte that no row was read from."""
        self._file.seek(-(len(self._block) - self._position + len(self._rest)), 1)

    def remaining(self) -> bool:
        """Whether anything but blanks is left."""
        return self._row < len(self._ends) or self._fill()

    def _take(self, element: Element) -> Iterator[tuple[bytes, NDArray[np.int64]]]:
        """(text, values in each of its rows) until all rows of the element are delivered."""
        wanted = element.count if element.properties else 0
        while wanted:
            if self._row == len(self._ends) and not self._fill():
                raise FormatError(
                    f"The file ends after {element.count - wanted} of the {element.count} rows "
                    f"of element {shown(element.name)}.",
                    code="truncated",
                    hint="The file is cut off, or its header declares too much: copy or export it again.",
                    limit=element.count,
                    actual=element.count - wanted,
                )
            stop = min(self._row + wanted, len(self._ends))
            counts = self._counts[self._row : stop]
            text = self._block[self._position : self._ends[stop - 1]]
            self._position, self._row = int(self._ends[stop - 1]), stop
            wanted -= len(counts)
            yield text, counts

    def _fill(self) -> bool:
        """Load the next block that holds a row; False at the end of the file."""
        while True:
            fresh = self._file.read(_BLOCK_BYTES)
            data = self._rest + (fresh if self._newline == b"\n" else fresh.replace(self._newline, b"\n"))
            if not data:
                return False
            cut = data.rfind(b"\n") + 1 if fresh else len(data)
            self._rest = data[cut:]
            if len(self._rest) > MAX_TEXT_LINE_BYTES:
                _not_text(f"A line of the body is longer than {MAX_TEXT_LINE_BYTES} bytes", MAX_TEXT_LINE_BYTES)
            if self._index(data[:cut]):
                return True

    def _index(self, block: bytes) -> bool:
        """Find the rows of a block; whether there are any."""
        octets = np.frombuffer(block, np.uint8)
        edges = np.diff(_IS_TOKEN[octets].astype(np.int8), prepend=0, append=0)
        starts, stops = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
        if starts.size and int((stops - starts).max()) > MAX_TOKEN_BYTES:
            _not_text(f"A value in the body is longer than {MAX_TOKEN_BYTES} characters", MAX_TOKEN_BYTES)
        newlines = np.flatnonzero(octets == ord("\n"))
        counts = np.bincount(np.searchsorted(newlines, starts), minlength=len(newlines) + 1)
        ends = np.append(newlines + 1, len(block))
        self._block, self._position, self._row = block, 0, 0
        self._ends, self._counts = ends[counts > 0], counts[counts > 0]
        return bool(self._ends.size)


def _not_text(what: str, limit: int) -> NoReturn:
    raise FormatError(
        f"{what}.",
        code="bad_value",
        hint="Write plain decimal numbers, separated by blanks, one line a row.",
        limit=limit,
    )


def _without_lists(text: bytes, element: Element, first: int) -> bytes:
    """Rows without the values of their lists."""
    kept = []
    for row, line in enumerate(filter(None, (line.split() for line in text.split(b"\n"))), start=first):
        at, values = 0, []
        for prop in element.properties:
            if prop.length_type:
                length = line[at] if at < len(line) else b""
                if not length.isdigit() or len(length) > 9:
                    _bad_value(element, row, f"has no length of the list {shown(prop.name)}")
                at += 1 + int(length)
            else:
                values += line[at : at + 1]
                at += 1
        if at != len(line):
            _bad_value(element, row, f"has {len(line)} values; with its lists it should have {at}")
        kept.append(b" ".join(values))
    return b"\n".join(kept) + b"\n"


def _parse(text: bytes, rows: int, element: Element, first: int) -> NDArray[np.float64]:
    """Return the numbers of some rows, (rows, properties)."""
    text = text.replace(b"\r", b" ")
    try:
        values = np.loadtxt(io.BytesIO(text), np.float64, comments=None, ndmin=2, encoding="latin-1")
    except ValueError:
        values = np.empty((0, 0))
    if values.shape != (rows, len(element.scalars)):
        _name_bad_value(text, element, first)
    return values


def _name_bad_value(text: bytes, element: Element, first: int) -> NoReturn:
    lines = (line for line in text.split(b"\n") if line.strip())
    for row, line in enumerate(lines, start=first):
        for token in line.split():
            try:
                np.loadtxt(io.BytesIO(token), np.float64, comments=None, ndmin=1, encoding="latin-1")
            except ValueError:
                _bad_value(element, row, f"holds {shown(token.decode('latin-1'))}, which is not a number")
    _bad_value(element, first, "or one after it holds characters that are not numbers")


def _bad_value(element: Element, row: int, what: str) -> NoReturn:
    raise FormatError(
        f"Row {row} of element {shown(element.name)} {what}.",
        code="bad_value",
        hint="Write plain decimal numbers that fit the type of their property.",
    )


def _convert(values: NDArray[np.float64], rows: NDArray[np.void], element: Element, first: int) -> None:
    """Store numbers in the types of their properties; integers must be whole and fit."""
    for column, prop in zip(values.T, element.scalars, strict=True):
        target = rows[prop.name]
        if target.dtype.kind != "f":
            bounds = np.iinfo(target.dtype)
            fits = (column >= bounds.min) & (column <= bounds.max) & (column == np.rint(column))
            if not fits.all():
                row = int(np.argmin(fits))
                _bad_value(
                    element,
                    first + row,
                    f"holds {column[row]:g} in {shown(prop.name)}, which has the type {prop.type}",
                )
        with np.errstate(over="ignore"):
            target[:] = column


def write_rows(file: BinaryIO, columns: list[NDArray[Any]]) -> None:
    """Write columns as text, with the digits that bring each value back exactly."""
    formats = {"f4": "%.9g", "f8": "%r"}
    line = " ".join(formats.get(column.dtype.str[1:], "%d") for column in columns) + "\n"
    for start in range(0, len(columns[0]), _ROWS_PER_WRITE):
        parts = [column[start : start + _ROWS_PER_WRITE].tolist() for column in columns]
        values = tuple(chain.from_iterable(zip(*parts, strict=True)))
        file.write((line * len(parts[0]) % values).encode("ascii"))
