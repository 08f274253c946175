"""The layout of a text file of columns: separator, count, names and comments, from its first lines."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

from ..comments import MAX_COMMENT_BYTES, MAX_LINE_BYTES, METADATA
from ..errors import FormatError, shown

MAX_COLUMNS = 256
MAX_ROW_BYTES = 64 * 1024

_COMMENT = re.compile(rb"[ \t]*(#|//|%)[ \t]?(.*)", re.DOTALL)
COLMAP_NAMES = ("point3d_id", "x", "y", "z", "r", "g", "b", "error")
"""Columns of COLMAP's ``points3D.txt``; the images that saw a point follow."""
_COLMAP = "POINT3D_ID"
_COUNT = re.compile(rb"[0-9]{1,19}")
_BYTE_ORDER_MARK = b"\xef\xbb\xbf"


@dataclass
class Layout:
    """What the lines before the first row say.

    Attributes
    ----------
    separator : bytes
        A comma, a semicolon, a tab or a blank; the last two stand for any white space.
    width : int
        Columns of the first row.
    names : tuple of str
        One a column, as spelled; empty when the file names none.
    plain : bool
        Whether the names stand in a line that is no comment.
    count : int or None
        The number of points, where the first line is one.
    newline : str
    marks : list of str
        ``#`` or ``//``, as the comments of the file begin.
    size : int
        Bytes before the first row.
    counts : list of int
        Those of further scans of a PTS, met between its rows.
    is_colmap : bool
        Whether the comments are those of COLMAP's ``points3D.txt``.
    """

    separator: bytes = b" "
    width: int = 0
    names: tuple[str, ...] = ()
    plain: bool = False
    count: int | None = None
    newline: str = "\n"
    marks: list[str] = field(default_factory=list)
    comments: list[str] = field(default_factory=list)
    metadata: dict[str, str] = field(default_factory=dict)
    comment_bytes: int = 0
    size: int = 0
    counts: list[int] = field(default_factory=list)
    is_colmap: bool = False

    def take_comment(self, line: bytes) -> bool:
        """Keep a line if it is a comment; whether it is one."""
        match = _COMMENT.match(line)
        if match is None:
            return False
        self.comment_bytes += len(line)
        for length, limit in ((len(line), MAX_LINE_BYTES), (self.comment_bytes, MAX_COMMENT_BYTES)):
            if length > limit:
                raise FormatError(
                    f"The comments of the file are longer than {limit} bytes"
                    f"{' a line' if limit == MAX_LINE_BYTES else ''}.",
                    code="header_too_long",
                    hint="Remove long or many comments.",
                    limit=limit,
                )
        text = match[2].decode("utf-8", "surrogateescape").rstrip("\r\n")
        recorded = METADATA.fullmatch(text)
        if recorded:
            self.metadata[recorded[1]] = recorded[2]
        else:
            self.marks.append(match[1].decode())
            self.comments.append(text)
        return True


def read_layout(head: bytes) -> Layout:
    """Detect the layout of a file that begins with `head`.

    Raises
    ------
    FormatError
        ``bad_value``, ``bad_shape``, ``too_many_elements``, ``missing_coordinates``, ``duplicate_property``
        or ``header_too_long``.
    """
    layout = Layout()
    if head.startswith(_BYTE_ORDER_MARK):
        layout.size = len(_BYTE_ORDER_MARK)
    first = True
    while True:
        end = head.find(b"\n", layout.size) + 1 or len(head)
        line = head[layout.size : end]
        if not line:
            raise FormatError(
                "The text has no row of numbers.", code="too_few_points", hint="Write one line of x y z a point."
            )
        layout.newline = "\r\n" if line.endswith(b"\r\n") else "\n"
        text = line.strip()
        if b"\0" in line or len(text) > MAX_ROW_BYTES:
            number = head.count(b"\n", 0, layout.size) + 1
            raise FormatError(
                f"Line {number} of the file is not text.",
                code="bad_value",
                hint="Save the cloud as text in ASCII or UTF-8, one line of x y z a point.",
            )
        if not text or layout.take_comment(line):
            layout.size = end
            continue
        if first and _COUNT.fullmatch(text) and layout.count is None:
            layout.count = int(text)
            layout.size = end
            continue
        if layout.count is not None and first and _COUNT.fullmatch(text):
            raise FormatError(
                "The file begins as a PTX does: with columns, rows and a position, not with rows of points.",
                code="bad_shape",
                hint="Name it .ptx to have its scans read.",
            )
        if first and not all(map(_is_number, cells(text, separator_of(text))[:3])):
            layout.names, layout.plain = _names(cells(text, separator_of(text))), True
            layout.separator = separator_of(text)
            layout.size, first = end, False
            continue
        _take_width(layout, text)
        return layout


def separator_of(row: bytes) -> bytes:
    """Detect the separator of the values of a row."""
    return next((mark for mark in (b";", b",", b"\t") if mark in row), b" ")


def cells(row: bytes, separator: bytes) -> list[bytes]:
    """Return the values of a row as they are spelled."""
    return row.split() if separator in b" \t" else row.split(separator)


def _is_number(cell: bytes) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _take_width(layout: Layout, row: bytes) -> None:
    """Width, separator and names, from the first row."""
    layout.separator = separator_of(row)
    layout.width = len(cells(row, layout.separator))
    if layout.names and len(layout.names) != layout.width:
        raise FormatError(
            f"The first line names {len(layout.names)} columns; the first row has {layout.width} values.",
            code="bad_value",
            hint="Name every column, separated as the values are.",
            limit=len(layout.names),
            actual=layout.width,
        )
    if not layout.names and any(_COLMAP in comment for comment in layout.comments):
        layout.is_colmap = True
        layout.names = tuple(COLMAP_NAMES[: layout.width])
        layout.names += tuple(f"track_{number}" for number in range(1, layout.width - len(layout.names) + 1))
    if not layout.names and layout.comments:
        commented = [cell.decode("utf-8", "surrogateescape") for cell in _cells_of(layout)]
        if len(commented) == layout.width and {"x", "y", "z"} <= {name.lower() for name in commented}:
            layout.names = _names([name.encode("utf-8", "surrogateescape") for name in commented])
            layout.comments.pop()
    if layout.width < 3:
        raise FormatError(
            f"The first row has {layout.width} values; points need three coordinates.",
            code="bad_shape",
            hint="Write one line of x y z a point, with decimal points, separated by blanks, commas or semicolons.",
            limit=3,
            actual=layout.width,
        )
    if layout.width > MAX_COLUMNS:
        raise FormatError(
            f"The rows have {layout.width} columns; at most {MAX_COLUMNS} are read.",
            code="too_many_elements",
            hint="Export fewer per-point values.",
            limit=MAX_COLUMNS,
            actual=layout.width,
        )


def _cells_of(layout: Layout) -> list[bytes]:
    last = layout.comments[-1].encode("utf-8", "surrogateescape")
    return cells(last, layout.separator if layout.separator in last else b" ")


def _names(spelled: Sequence[bytes]) -> tuple[str, ...]:
    names = tuple(cell.strip().strip(b'"').decode("utf-8", "surrogateescape") for cell in spelled)
    lower = [name.lower() for name in names]
    missing = [axis for axis in "xyz" if axis not in lower]
    if missing:
        seen = ", ".join(shown(name) for name in names[:8])
        raise FormatError(
            f"The first line holds neither numbers nor a column named {', '.join(missing)}; it reads: {seen}.",
            code="missing_coordinates",
            hint="Name the coordinates x, y and z, or begin with a row of numbers.",
        )
    twice = next((name for index, name in enumerate(lower) if name in lower[:index]), None)
    if twice is not None:
        raise FormatError(
            f"Two columns are named {shown(twice)}.", code="duplicate_property", hint="Rename or remove one of them."
        )
    return names
