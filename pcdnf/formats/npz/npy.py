"""One ``.npy`` array: its header read by ourselves, under a bound, without evaluating it.

The format: https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError, shown
from .inflate import Member, MemberStream

MAX_HEADER_BYTES = 4096
MAX_DIMENSIONS = 8
MAX_TEXT_BYTES = 512 * 1024
"""Of a text scalar."""

_NUMBER = re.compile(r"[<>=|]?(?:f[248]|[iu][1248])")
_TRUTH = "|b1"
_FIELD = re.compile(
    r"\s*\(\s*(['\"])(?P<name>[^'\"\\]{1,64})\1\s*,\s*'(?P<descr>[<>=|]?(?:f[248]|[iu][1248]|b1))'\s*"
    r"(?:,\s*\((?P<shape>[0-9]{1,4}),?\)\s*)?\)\s*(?:,\s*|$)"
)
MAX_FIELDS = 256
_TEXT = re.compile(r"[<>=|]?[US][0-9]{1,6}")
_ITEM = re.compile(
    r"\s*(['\"])(?P<key>descr|fortran_order|shape)\1\s*:\s*"
    r"(?:'(?P<text>[^']*)'|(?P<truth>True|False)|\((?P<shape>[0-9,\s]*)\)|(?P<fields>\[.*\]))\s*(?:,\s*|$)",
    re.DOTALL,
)


@dataclass(frozen=True)
class ArrayHeader:
    """What a ``.npy`` declares; ``body`` is the number of bytes that follow its header."""

    dtype: np.dtype[Any]
    fortran: bool
    shape: tuple[int, ...]
    body: int

    @property
    def is_text(self) -> bool:
        """Whether the array is a text scalar."""
        return self.dtype.kind in "US"


def read_array_header(stream: MemberStream, member: Member, *, text: bool = False, truth: bool = False) -> ArrayHeader:
    """Read the header at the start of a member, and check that the member has the bytes it declares.

    Parameters
    ----------
    stream : MemberStream
        At its first byte.
    member : Member
        Whose name and size the errors name.
    text : bool
        Whether a text scalar is accepted beside numbers.
    truth : bool
        Whether truth values are.

    Raises
    ------
    FormatError
        ``bad_header``, ``header_too_long``, ``unsupported_dtype``, ``member_too_large``, ``truncated``
        or ``trailing_data``.
    """
    declared, header_size = _declared(stream, member)
    descr, shape = declared["text"], declared["shape"]
    is_text = text and _TEXT.fullmatch(descr) is not None and shape == ()
    fields = parsed_fields(descr) if len(shape) == 1 else None
    if not is_text and fields is None and not _NUMBER.fullmatch(descr) and not (truth and descr == _TRUTH):
        kind = "of Python objects (a pickle)" if "O" in descr else f"of type {shown(descr)}"
        raise FormatError(
            f"Member {shown(member.name)} is an array {kind}; only real numbers are read: "
            "f2, f4, f8 and integers of 1 to 8 bytes.",
            code="unsupported_dtype",
            hint="Leave it out, or convert it, e.g. .astype(numpy.float32) or .astype(numpy.uint8).",
        )
    if is_text and member.size > MAX_TEXT_BYTES:
        raise FormatError(
            f"The text member {shown(member.name)} has {member.size} bytes; the limit is {MAX_TEXT_BYTES}.",
            code="member_too_large",
            hint="Leave it out.",
            limit=MAX_TEXT_BYTES,
            actual=member.size,
        )
    dtype = np.dtype(descr if fields is None else fields)
    header = ArrayHeader(dtype, declared["fortran"], shape, prod(shape) * dtype.itemsize)
    present = member.size - header_size
    if header.body != present:
        raise FormatError(
            f"Member {shown(member.name)} declares {shape_text(shape)} of {dtype}, {header.body} bytes; "
            f"it has {present}.",
            code="truncated" if header.body > present else "trailing_data",
            hint="The file is damaged: copy it again, or save it again with numpy.savez.",
            limit=header.body,
            actual=present,
        )
    return header


def _declared(stream: MemberStream, member: Member) -> tuple[dict[str, Any], int]:
    """Return the three values of a header as {"text", "fortran", "shape"}, and its size in bytes."""
    magic = stream.take(min(8, member.size))
    if len(magic) < 8 or not magic.startswith(b"\x93NUMPY") or magic[6] not in (1, 2, 3):
        raise _bad_header(member)
    width = 2 if magic[6] == 1 else 4
    length = int.from_bytes(stream.take(min(width, member.size - 8)), "little")
    if length > MAX_HEADER_BYTES:
        raise FormatError(
            f"The header of member {shown(member.name)} has {length} bytes; the limit is {MAX_HEADER_BYTES}.",
            code="header_too_long",
            hint="Save it again with numpy.savez.",
            limit=MAX_HEADER_BYTES,
            actual=length,
        )
    if 8 + width + length > member.size:
        raise _bad_header(member)
    literal = stream.take(length).decode("latin-1").strip()
    if not (literal.startswith("{") and literal.endswith("}")):
        raise _bad_header(member)
    items = _items(literal[1:-1])
    if items is None:
        raise _bad_header(member)
    text = items["descr"]["text"]
    truth, dims = items["fortran_order"]["truth"], items["shape"]["shape"]
    sizes = [part.strip() for part in (dims or "").split(",")]
    if sizes[-1] == "":
        sizes.pop()
    elif len(sizes) == 1:
        raise _bad_header(member)
    legal = all(re.fullmatch("[0-9]{1,19}", part) for part in sizes) and len(sizes) <= MAX_DIMENSIONS
    if truth is None or dims is None or not legal or (text is None and items["descr"]["fields"] is None):
        raise _bad_header(member)
    descr = text if text is not None else items["descr"]["fields"]
    return {"text": descr, "fortran": truth == "True", "shape": tuple(map(int, sizes))}, 8 + width + length


def _items(body: str) -> dict[str, dict[str, str | None]] | None:
    """Return the items of the header's dictionary by key; None unless they are exactly the three known ones."""
    items: dict[str, dict[str, str | None]] = {}
    position = 0
    while position < len(body):
        match = _ITEM.match(body, position)
        if match is None or match["key"] in items:
            return None
        items[match["key"]] = match.groupdict()
        position = match.end()
    return items if len(items) == 3 else None


def parsed_fields(descr: str) -> list[tuple[str, str] | tuple[str, str, tuple[int]]] | None:
    """Return the fields of a structured array, (name, type) or (name, type, (count,)) each; None for anything else."""
    body = descr.strip()
    if not (body.startswith("[") and body.endswith("]")):
        return None
    body = body[1:-1]
    fields: list[tuple[str, str] | tuple[str, str, tuple[int]]] = []
    position = 0
    while position < len(body):
        match = _FIELD.match(body, position)
        if match is None or len(fields) == MAX_FIELDS or any(match["name"] == field[0] for field in fields):
            return None
        kind = match["descr"].replace("b1", "u1")
        fields.append((match["name"], kind, (int(match["shape"]),)) if match["shape"] else (match["name"], kind))
        position = match.end()
    return fields or None


def _bad_header(member: Member) -> FormatError:
    return FormatError(
        f"Member {shown(member.name)} does not begin with a valid .npy header.",
        code="bad_header",
        hint="Save it again with numpy.savez.",
    )


def read_array(stream: MemberStream, header: ArrayHeader) -> NDArray[Any]:
    """Return the array after a header, with its own type, byte order and memory order."""
    octets = np.empty(header.body, np.uint8)
    stream.fill(octets.data)
    stream.finish()
    if header.dtype == bool:
        octets = np.minimum(octets, 1)  # numpy takes other bytes for neither true nor false
    return octets.view(header.dtype).reshape(header.shape, order="F" if header.fortran else "C")


def read_text(stream: MemberStream, header: ArrayHeader) -> str:
    """Return the text scalar after a header."""
    raw = stream.take(header.body)
    stream.finish()
    if header.dtype.kind == "S":
        return raw.decode("utf-8", "replace").rstrip("\0")
    return raw.decode("utf-32-be" if header.dtype.str[0] == ">" else "utf-32-le", "replace").rstrip("\0")


def shape_text(shape: tuple[int, ...]) -> str:
    """Return a shape as Python writes it."""
    return str(tuple(shape))
