"""The header of a PLY file: read under bounds, checked against the rules, written.

The format: https://paulbourke.net/dataformats/ply/. No array is allocated here.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import BinaryIO, NoReturn

import numpy as np

from ..errors import FormatError, shown

MAX_HEADER_BYTES = 64 * 1024
MAX_LINE_BYTES = 1000
MAX_PARTS = 256
"""Elements, and properties of one of them (a vertex of a Gaussian-splat file has 62 and more)."""

BYTE_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"},
    **{"int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"},
}
"""Type names of the format, in both spellings, to numpy's."""

SPELLINGS = {dtype: name for name, dtype in reversed(TYPES.items())} | {"i1": "int8", "i2": "int16", "u2": "uint16"}
"""numpy's type names to the spelling that most readers know: the older one, but for the types that Open3D and meshio
know by their newer names only."""

_COUNT = re.compile(r"[0-9]{1,19}")
_NAME = re.compile(r"[\x21-\x7e]{1,64}")
_METADATA = re.compile(r"pcdnf ([a-z0-9_]{1,64}): (.*)")


@dataclass(frozen=True)
class Property:
    """One column: its name, its type as spelled, and the type of its length when it is a list."""

    name: str
    type: str
    length_type: str | None = None


@dataclass
class Element:
    """A table: its rows are of fixed size unless a property is a list."""

    name: str
    count: int
    properties: list[Property] = field(default_factory=list)

    @property
    def has_list(self) -> bool:
        """Whether a row's size depends on the row."""
        return any(prop.length_type for prop in self.properties)

    @property
    def least_stride(self) -> int:
        """Bytes of a binary row; for rows with lists, of one whose lists are empty."""
        return sum(np.dtype(TYPES[p.length_type or p.type]).itemsize for p in self.properties)

    @property
    def scalars(self) -> list[Property]:
        """The properties that are no lists."""
        return [prop for prop in self.properties if not prop.length_type]

    def row_dtype(self, byte_order: str) -> np.dtype[np.void]:
        """Return the type of a binary row, without its lists."""
        return np.dtype([(p.name, byte_order + TYPES[p.type]) for p in self.scalars])

    def lines(self) -> list[str]:
        """Return the element as lines of a header."""
        listed = [
            f"property list {p.length_type} {p.type} {p.name}" if p.length_type else f"property {p.type} {p.name}"
            for p in self.properties
        ]
        return [f"element {self.name} {self.count}", *listed]


@dataclass
class Header:
    """What a header declares; ``size`` is the number of its bytes."""

    encoding: str
    elements: list[Element]
    comments: list[str]
    obj_info: list[str]
    metadata: dict[str, str]
    size: int
    newline: bytes = b"\n"

    @property
    def vertex(self) -> Element:
        """The element that holds the points."""
        return next(element for element in self.elements if element.name == "vertex")


def read_header(file: BinaryIO) -> Header:
    """Parse the header at the start of a file that is open at its first byte.

    Raises
    ------
    FormatError
        ``bad_header``, ``header_too_long``, ``too_many_elements``, ``duplicate_property``,
        ``unsupported_type`` or ``missing_coordinates``.
    """
    lines, size, newline = _lines(file)
    header = Header("", [], [], [], {}, size, newline)
    for number, line in enumerate(lines[1:-1], start=2):
        words = line.split()
        keyword = words[0] if words else ""
        text = line.lstrip()[len(keyword) + 1 :]
        if keyword == "comment":
            _take_comment(header, text)
        elif keyword == "obj_info":
            header.obj_info.append(text)
        elif keyword == "format":
            if header.encoding or header.elements:
                _bad(number, "there must be one format line, before the first element")
            header.encoding = _encoding(words, number)
        elif keyword == "element":
            header.elements.append(_element(words, number, {element.name for element in header.elements}))
        elif keyword == "property":
            _take_property(header, words, number)
        else:
            _bad(number, f"{shown(line)} is none of format, comment, obj_info, element, property, end_header")
        parts = max(len(header.elements), len(header.elements[-1].properties) if header.elements else 0)
        if parts > MAX_PARTS:
            raise FormatError(
                f"The header declares more than {MAX_PARTS} elements, or properties of one.",
                code="too_many_elements",
                hint="Export fewer per-point properties.",
                limit=MAX_PARTS,
                actual=parts,
            )
    _check_complete(header)
    return header


def _lines(file: BinaryIO) -> tuple[list[str], int, bytes]:
    """Read the lines of the header without their ends; return them, the header's size in bytes, and the line end."""
    lines: list[str] = []
    size = 0
    start = file.read(5)
    file.seek(0)
    newline = b"\r" if start[3:4] == b"\r" and start[4:] != b"\n" else b"\n"
    source = file if newline == b"\n" else io.BytesIO(file.read(MAX_HEADER_BYTES).replace(b"\r", b"\n"))
    while True:
        line = source.readline(MAX_LINE_BYTES + 3)
        size += len(line)
        text = line.removesuffix(b"\n").removesuffix(b"\r")
        if len(text) > MAX_LINE_BYTES:
            _too_long(f"Line {len(lines) + 1} of the header", MAX_LINE_BYTES)
        if size > MAX_HEADER_BYTES:
            _too_long("The header", MAX_HEADER_BYTES)
        if not line.endswith(b"\n"):
            raise FormatError(
                "The header has no end_header line.",
                code="bad_header",
                hint="The file may be cut off: copy or export it again.",
            )
        lines.append(text.decode("utf-8", "surrogateescape"))
        if text == b"end_header":
            file.seek(size)
            return lines, size, newline


def _too_long(what: str, limit: int) -> NoReturn:
    raise FormatError(
        f"{what} is longer than {limit} bytes.",
        code="header_too_long",
        hint="Remove long or many comments from the header.",
        limit=limit,
    )


def _bad(number: int, what: str) -> NoReturn:
    raise FormatError(
        f"Line {number} of the PLY header is wrong: {what}.",
        code="bad_header",
        hint="Export the file again with a tool that writes standard PLY.",
    )


def _take_comment(header: Header, text: str) -> None:
    match = _METADATA.fullmatch(text)
    if match:
        header.metadata[match[1]] = match[2]
    else:
        header.comments.append(text)


def _encoding(words: list[str], number: int) -> str:
    if len(words) != 3 or words[1] not in BYTE_ORDERS or words[2] != "1.0":
        _bad(number, f"the format must be one of {', '.join(BYTE_ORDERS)}, with version 1.0")
    return words[1]


def _name(word: str, number: int) -> str:
    if not _NAME.fullmatch(word):
        _bad(number, "names have 1 to 64 printable ASCII characters")
    return word


def _element(words: list[str], number: int, known: set[str]) -> Element:
    if len(words) != 3:
        _bad(number, "an element line is `element <name> <count>`")
    name = _name(words[1], number)
    if not _COUNT.fullmatch(words[2]) or int(words[2]) >= 2**63:
        _bad(number, f"the count of {shown(name)} must be a whole number of 0 or more, not {shown(words[2])}")
    if name in known:
        _bad(number, f"element {shown(name)} is declared twice")
    return Element(name, int(words[2]))


def _take_property(header: Header, words: list[str], number: int) -> None:
    if not header.elements:
        _bad(number, "a property comes before the first element")
    if words[1:2] == ["list"] and len(words) == 5:
        prop = Property(_name(words[4], number), words[3], words[2])
    elif words[1:2] != ["list"] and len(words) == 3:
        prop = Property(_name(words[2], number), words[1])
    else:
        _bad(number, "a property line is `property <type> <name>` or `property list <type> <type> <name>`")
    for spelled in filter(None, (prop.length_type, prop.type)):
        if spelled not in TYPES or (spelled is prop.length_type and TYPES[spelled][0] == "f"):
            raise FormatError(
                f"Property {shown(prop.name)} has the type {shown(spelled)}, which PLY does not allow.",
                code="unsupported_type",
                hint=f"The types are {', '.join(SPELLINGS.values())}; lengths of lists are integers.",
            )
    element = header.elements[-1]
    if any(prop.name == other.name for other in element.properties):
        raise FormatError(
            f"Element {shown(element.name)} has two properties named {shown(prop.name)}.",
            code="duplicate_property",
            hint="Rename or remove one of them.",
        )
    element.properties.append(prop)


def _check_complete(header: Header) -> None:
    if not header.encoding:
        raise FormatError(
            "The PLY header has no format line.",
            code="bad_header",
            hint="Export the file again with a tool that writes standard PLY.",
        )
    vertices = [element for element in header.elements if element.name == "vertex"]
    names = {prop.name for prop in vertices[0].properties if not prop.length_type} if vertices else set()
    missing = [name for name in "xyz" if name not in names]
    if missing:
        seen = ", ".join(shown(name) for name in sorted(names)[:8]) or "none"
        raise FormatError(
            f"The vertex element has no property {', '.join(missing)}; its properties are: {seen}.",
            code="missing_coordinates",
            hint="Name the coordinates x, y and z in an element named vertex.",
        )


def header_bytes(
    encoding: str,
    count: int,
    properties: Iterable[tuple[str, str]],
    lines: Iterable[str],
    before: Iterable[str] = (),
    after: Iterable[str] = (),
) -> bytes:
    """Return the header of a file of vertices.

    Parameters
    ----------
    encoding : str
        A key of :data:`BYTE_ORDERS`.
    count : int
        Number of vertices.
    properties : iterable of (name, type as spelled)
    lines : iterable of str
        ``comment …`` and ``obj_info …`` lines, put after the format line.
    before, after : iterable of str
        Lines of the other elements.
    """
    text = ["ply", f"format {encoding} 1.0", *lines, *before, f"element vertex {count}"]
    text += [f"property {spelled} {name}" for name, spelled in properties]
    return ("\n".join([*text, *after, "end_header"]) + "\n").encode("utf-8", "surrogateescape")


def note_lines(keyword: str, texts: Iterable[str]) -> list[str]:
    """Header lines out of free text: one a line of it, the long ones wrapped to what a reader accepts."""
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
