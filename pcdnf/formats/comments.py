"""Comments in the headers of text: their limits, and the metadata that results record in them."""

from __future__ import annotations

import re
from collections.abc import Iterable

MAX_LINE_BYTES = 1000
"""Of a comment, and of a line of a PLY header."""
MAX_COMMENT_BYTES = 64 * 1024
"""Of a header, or of all comments of a file of columns."""

METADATA = re.compile(r"pcdnf ([a-z0-9_]{1,64}): (.*)")
"""A comment that records how a result was made: its key and its value."""


def note_lines(keyword: str, texts: Iterable[str]) -> list[str]:
    """Return free text as lines of a header, the long ones wrapped to the length that readers accept.

    Parameters
    ----------
    keyword : str
        The word or mark that begins each line.
    texts : iterable of str
        One or more lines each.
    """
    width = MAX_LINE_BYTES - len(keyword) - 1
    lines = []
    for text in texts:
        for piece in text.replace("\r", "\n").split("\n"):
            rest = piece.encode("utf-8", "surrogateescape")
            while len(rest) > width:
                cut = next((at for at in range(width, width - 4, -1) if rest[at] & 0xC0 != 0x80), width)
                lines.append(f"{keyword} {rest[:cut].decode('utf-8', 'surrogateescape')}")
                rest = rest[cut:]
            lines.append(f"{keyword} {rest.decode('utf-8', 'surrogateescape')}")
    return lines
