"""The rows of a text file of columns: whole lines are taken in blocks and cut by numpy."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, BinaryIO, NoReturn

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError, shown
from ..ply.text import MAX_TOKEN_BYTES
from .layout import MAX_ROW_BYTES, Layout

Cells = NDArray[np.bytes_]

_BLOCK_BYTES = 4 * 1024**2
_IS_TOKEN = np.ones(256, bool)
_IS_TOKEN[[9, 10, 11, 12, 13, 32]] = False


class Block:
    """Some rows: where each of their values begins and ends.

    Attributes
    ----------
    first : int
        The number of the first row in the file.
    """

    def __init__(self, octets: NDArray[np.uint8], starts: NDArray[Any], stops: NDArray[Any], first: int) -> None:
        self._octets, self._starts, self._stops = octets, starts, stops
        self.first = first

    def __len__(self) -> int:
        return len(self._starts)

    def text(self, column: int) -> Cells:
        """Return a column as it is spelled, (rows,)."""
        starts, lengths = self._starts[:, column], self._stops[:, column] - self._starts[:, column]
        width = max(1, int(lengths.max()))
        reach = np.arange(width)
        filled = reach < lengths[:, None]
        table = np.zeros((len(self), width), np.uint8)
        table[filled] = self._octets[(starts[:, None] + reach)[filled]]
        return table.view(f"S{width}")[:, 0]

    def numbers(self, column: int) -> NDArray[np.float64]:
        """Return a column as numbers, (rows,).

        Raises
        ------
        FormatError
            ``bad_value``.
        """
        text = self.text(column)
        try:
            values: NDArray[np.float64] = text.astype(np.float64)
        except ValueError:
            values = np.empty(0)
        if len(values) < len(text) or bool((text.view(np.uint8) == ord("_")).any()):
            self._name_bad_value(text, column)
        return values

    def _name_bad_value(self, text: Cells, column: int) -> NoReturn:
        for row, cell in enumerate(text.tolist()):
            try:
                wrong = b"_" in cell or float(cell) is None
            except ValueError:
                wrong = True
            if wrong:
                raise FormatError(
                    f"Row {self.first + row} holds {shown(cell.decode('latin-1'))} in column {column + 1}, "
                    "which is not a number.",
                    code="bad_value",
                    hint="Write plain numbers with decimal points.",
                )
        raise AssertionError("a column that cannot be converted has a cell that cannot")


def blocks(file: BinaryIO, layout: Layout) -> Iterator[Block]:
    """Yield the rows of an open file, which stands at the first of them; comments go to the layout.

    Raises
    ------
    FormatError
        ``bad_value`` or ``header_too_long``.
    """
    rest = b""
    row = 0
    while True:
        fresh = file.read(_BLOCK_BYTES)
        data = rest + fresh
        if not data:
            return
        cut = data.rfind(b"\n") + 1 if fresh else len(data)
        rest = data[cut:]
        if len(rest) > MAX_ROW_BYTES:
            _not_text(f"A line is longer than {MAX_ROW_BYTES} bytes", MAX_ROW_BYTES)
        block = _cut(_without_comments(data[:cut], layout), layout, row)
        if block is not None:
            row += len(block)
            yield block


def _without_comments(data: bytes, layout: Layout) -> bytes:
    if b"\0" in data:
        _not_text("The file holds bytes that are not text", None)
    data = data.replace(b"\r\n", b"\n")
    if b"#" not in data and b"//" not in data and b"%" not in data:
        return data
    return b"\n".join(line for line in data.split(b"\n") if not layout.take_comment(line))


def _cut(data: bytes, layout: Layout, first: int) -> Block | None:
    """Find the values of each row; None where there is none."""
    octets = np.frombuffer(data, np.uint8)
    newlines = np.flatnonzero(octets == ord("\n"))
    begins, ends = np.append(0, newlines + 1), np.append(newlines, len(octets))
    edges = np.diff(_IS_TOKEN[octets].astype(np.int8), prepend=0, append=0)
    starts, stops = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    tokens = np.bincount(np.searchsorted(newlines, starts), minlength=len(begins))
    rows = np.flatnonzero(tokens)
    if not rows.size:
        return None
    if layout.separator in b" \t":
        counts = tokens[rows]
    else:
        marks = np.flatnonzero(octets == layout.separator[0])
        counts = np.bincount(np.searchsorted(newlines, marks), minlength=len(begins))[rows] + 1
    if layout.count is not None and layout.width > 1 and (counts == 1).any():
        rows, counts = _without_counts(data, layout, rows, counts, starts, stops, newlines)
        tokens_kept = np.isin(np.searchsorted(newlines, starts), rows)
        starts, stops = starts[tokens_kept], stops[tokens_kept]
        if not rows.size:
            return None
    wrong = np.flatnonzero(counts != layout.width)
    if wrong.size:
        colmap = "Export the model of COLMAP as PLY: colmap model_converter --output_type PLY."
        raise FormatError(
            f"Row {first + wrong[0]} has {counts[wrong[0]]} values; the first row has {layout.width}.",
            code="bad_value",
            hint=colmap if layout.is_colmap else "Write as many values in every row, separated alike.",
            limit=layout.width,
            actual=int(counts[wrong[0]]),
        )
    if layout.separator in b" \t":
        low, high = starts.reshape(len(rows), -1), stops.reshape(len(rows), -1)
    else:
        inner = marks.reshape(len(rows), -1)
        low = np.concatenate([begins[rows, None], inner + 1], axis=1)
        high = np.concatenate([inner, ends[rows, None]], axis=1)
    if int((high - low).max()) > MAX_TOKEN_BYTES:
        _not_text(f"A value is longer than {MAX_TOKEN_BYTES} characters", MAX_TOKEN_BYTES)
    return Block(octets, low, high, first)


def _without_counts(
    data: bytes,
    layout: Layout,
    rows: NDArray[Any],
    counts: NDArray[Any],
    starts: NDArray[Any],
    stops: NDArray[Any],
    newlines: NDArray[Any],
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Rows without those that hold one whole number: the count of the next scan of a PTS."""
    single = counts == 1
    lines = np.searchsorted(newlines, starts)
    keep = ~single
    for place in np.flatnonzero(single).tolist():
        token = int(np.searchsorted(lines, rows[place]))
        text = data[starts[token] : stops[token]]
        if text.isdigit() and len(text) < 19:
            layout.counts.append(int(text))
        else:
            keep[place] = True
    return rows[keep], counts[keep]


def _not_text(what: str, limit: int | None) -> NoReturn:
    raise FormatError(
        f"{what}.",
        code="bad_value",
        hint="Save the cloud as text in ASCII or UTF-8, one line of x y z a point.",
        limit=limit,
    )
