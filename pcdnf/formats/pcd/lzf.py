"""LZF, the compression of PCD files, in the direction of the reader: every index is checked.

A control byte under 32 is followed by that many plus one literal bytes. Any other holds a length in its upper
three bits (7: one more byte of it follows) and, with the byte after it, the distance of an earlier copy.
"""

from __future__ import annotations

MAX_RATIO = 88
"""Three bytes stand for at most 264."""

_LONGEST_RUN = 32


def decompress(data: bytes, size: int) -> bytearray | None:
    """Decompress `data` to exactly `size` bytes, or return None if it holds another number of bytes.

    In plain Python, so that checking an upload loads no compiler: 0.01 to 0.15 s a megabyte.
    """
    out = bytearray()
    at, end = 0, len(data)
    while at < end and len(out) <= size:
        control = data[at]
        at += 1
        if control < _LONGEST_RUN:
            out += data[at : at + control + 1]
            at += control + 1
            continue
        length = control >> 5
        if length == 7 and at < end:
            length += data[at]
            at += 1
        if at >= end:
            return None
        source = len(out) - ((control & 31) << 8) - data[at] - 1
        at += 1
        length += 2
        if source < 0:
            return None
        piece = out[source : source + length]
        if len(piece) < length:  # the copy overlaps what it makes
            piece = (piece * (length // len(piece) + 1))[:length]
        out += piece
    return out if at == end and len(out) == size else None
