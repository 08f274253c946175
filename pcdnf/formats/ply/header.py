"""The header of a PLY file: read under bounds, checked against the rules, written.

The format: https://paulbourke.net/dataformats/ply/. No array is allocated here.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import BinaryIO

from ..comments import MAX_COMMENT_BYTES, MAX_LINE_BYTES, METADATA
from ..errors import FormatError, shown
from ..header_errors import HeaderErrors
from ..roles import COORDINATES, find_coordinates
from .elements import BYTE_ORDERS, SPELLINGS, TYPES, Element, Property

MAX_PARTS = 256
"""Elements, and properties of one of them (a vertex of a Gaussian-splat file has 62 and more)."""

_COUNT = re.compile(r"[0-9]{1,19}")
_NAME = re.compile(r"[\x21-\x7e]{1,64}")
ERRORS = HeaderErrors("PLY header", "Export the file again with a tool that writes standard PLY.")


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
                ERRORS.wrong("there must be one format line, before the first element", line=number)
            header.encoding = _encoding(words, number)
        elif keyword == "element":
            header.elements.append(_element(words, number, {element.name for element in header.elements}))
        elif keyword == "property":
            _take_property(header, words, number)
        else:
            ERRORS.wrong(
                f"{shown(line)} is none of format, comment, obj_info, element, property, end_header", line=number
            )
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
    source = file if newline == b"\n" else io.BytesIO(file.read(MAX_COMMENT_BYTES).replace(b"\r", b"\n"))
    while True:
        line = source.readline(MAX_LINE_BYTES + 3)
        size += len(line)
        text = line.removesuffix(b"\n").removesuffix(b"\r")
        if len(text) > MAX_LINE_BYTES:
            ERRORS.too_long(f"Line {len(lines) + 1} of the header", MAX_LINE_BYTES)
        if size > MAX_COMMENT_BYTES:
            ERRORS.too_long("The header", MAX_COMMENT_BYTES)
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


def _take_comment(header: Header, text: str) -> None:
    match = METADATA.fullmatch(text)
    if match:
        header.metadata[match[1]] = match[2]
    else:
        header.comments.append(text)


def _encoding(words: list[str], number: int) -> str:
    if len(words) != 3 or words[1] not in BYTE_ORDERS or words[2] != "1.0":
        ERRORS.wrong(f"the format must be one of {', '.join(BYTE_ORDERS)}, with version 1.0", line=number)
    return words[1]


def _name(word: str, number: int) -> str:
    if not _NAME.fullmatch(word):
        ERRORS.wrong("names have 1 to 64 printable ASCII characters", line=number)
    return word


def _element(words: list[str], number: int, known: set[str]) -> Element:
    if len(words) != 3:
        ERRORS.wrong("an element line is `element <name> <count>`", line=number)
    name = _name(words[1], number)
    if not _COUNT.fullmatch(words[2]) or int(words[2]) >= 2**63:
        ERRORS.wrong(
            f"the count of {shown(name)} must be a whole number of 0 or more, not {shown(words[2])}", line=number
        )
    if name in known:
        ERRORS.wrong(f"element {shown(name)} is declared twice", line=number)
    return Element(name, int(words[2]))


def _take_property(header: Header, words: list[str], number: int) -> None:
    if not header.elements:
        ERRORS.wrong("a property comes before the first element", line=number)
    if words[1:2] == ["list"] and len(words) == 5:
        prop = Property(_name(words[4], number), words[3], words[2])
    elif words[1:2] != ["list"] and len(words) == 3:
        prop = Property(_name(words[2], number), words[1])
    else:
        ERRORS.wrong("a property line is `property <type> <name>` or `property list <type> <type> <name>`", line=number)
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
        ERRORS.wrong("it has no format line")
    vertices = [element for element in header.elements if element.name == "vertex"]
    names = {prop.name for prop in vertices[0].properties if not prop.length_type} if vertices else set()
    if find_coordinates(names) is None:
        missing = [name for name in COORDINATES if not {name, name.upper()} & names]
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
