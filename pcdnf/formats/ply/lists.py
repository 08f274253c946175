"""Binary PLY elements with lists: the end of the faces, and the numbers of vertices next to their lists."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError, shown
from .elements import TYPES, Element

_LARGEST_RUN = 1 << 20


def skip_lists(data: bytes, element: Element, byte_order: str) -> int:
    """Bytes that the rows of ``element`` take at the start of ``data``.

    Rows whose lists are as long as those of the row before (triangles, mostly) are checked many at a time.

    Raises
    ------
    FormatError
        ``truncated`` when the data ends first, ``bad_value`` for a list of negative length.
    """
    octets = np.frombuffer(data, np.uint8)
    position = row = 0
    run = 1
    while row < element.count:
        stride, lengths = _layout(data, position, element, byte_order, row)
        block = min(run, element.count - row, (len(data) - position) // stride)
        if block > 1:
            window = octets[position : position + block * stride].reshape(block, stride)
            alike = (window[:, lengths] == window[0, lengths]).all(axis=1)
            block = block if alike.all() else int(np.argmin(alike))
        run = min(2 * run, _LARGEST_RUN) if block == run else 1
        position += block * stride
        row += block
    return position


def scalar_rows(data: bytes, element: Element, byte_order: str) -> NDArray[Any]:
    """Read the values of an element that are not lists, one structured row each, and skip its lists.

    Raises
    ------
    FormatError
        ``truncated`` or ``bad_value``, as :func:`skip_lists`.
    """
    rows = np.zeros(element.count, element.row_dtype(byte_order))
    starts = np.empty((element.count, len(element.properties)), np.int64)
    position = 0
    for row in range(element.count):
        _, _, places = _places(data, position, element, byte_order, row)
        starts[row] = places[:-1]
        position = places[-1]
    octets = np.frombuffer(data, np.uint8)
    for number, prop in enumerate(element.properties):
        if not prop.length_type:
            kind = rows.dtype[prop.name]
            at = starts[:, number, None] + np.arange(kind.itemsize)
            rows[prop.name] = np.ascontiguousarray(octets[at]).view(kind)[:, 0]
    return rows


def _layout(data: bytes, position: int, element: Element, byte_order: str, row: int) -> tuple[int, list[int]]:
    """Size of the row at ``position``, and the places inside it of the octets that hold list lengths."""
    size, lengths, _ = _places(data, position, element, byte_order, row)
    return size, lengths


def _places(
    data: bytes, position: int, element: Element, byte_order: str, row: int
) -> tuple[int, list[int], list[int]]:
    """Of the row at ``position``: its size, the places of octets of list lengths in it, and where properties begin."""
    order: Literal["little", "big"] = "little" if byte_order == "<" else "big"
    at = position
    lengths: list[int] = []
    begins: list[int] = []
    for prop in element.properties:
        begins.append(at)
        width = int(TYPES[prop.type][1])
        if prop.length_type is not None:
            kind = TYPES[prop.length_type]
            octets = int(kind[1])
            length = int.from_bytes(data[at : at + octets], order, signed=kind[0] == "i")
            if length < 0:
                raise FormatError(
                    f"Row {row} of element {shown(element.name)} holds a list of negative length.",
                    code="bad_value",
                    hint="The file is damaged: copy or export it again.",
                )
            lengths += range(at - position, at - position + octets)
            at += octets
            width *= length
        at += width
        if at > len(data):
            raise FormatError(
                f"The file ends inside row {row} of element {shown(element.name)}, which declares {element.count}.",
                code="truncated",
                hint="The file is cut off, or its header declares too much: copy or export it again.",
                limit=element.count,
                actual=row,
            )
    return at - position, lengths, [*begins, at]
