"""The header of a PCD file: read under bounds, checked against the rules, written.

The format: https://pointclouds.org/documentation/tutorials/pcd_file_format.html. No array is allocated here.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, BinaryIO, NoReturn

import numpy as np

from ..comments import MAX_COMMENT_BYTES, MAX_LINE_BYTES, METADATA
from ..errors import FormatError, shown
from ..header_errors import HeaderErrors

MAX_FIELD_LINE_BYTES = 16 * 1024
"""Of a line that has a value for each field."""
MAX_FIELDS = 256
MAX_VALUES = 4096
"""Values of a point, over all fields (a global descriptor has 308)."""

ENCODINGS = ("ascii", "binary", "binary_compressed")
FIRST_LINE = "# .PCD v0.7 - Point Cloud Data file format"
PADDING = "_"

_TYPES = {f"{kind}{size}": f"{kind.lower()}{size}" for kind in "IU" for size in (1, 2, 4, 8)} | {"F4": "f4", "F8": "f8"}
_KEYWORDS = ("VERSION", "FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA")
_REQUIRED = ("FIELDS", "SIZE", "TYPE", "WIDTH", "HEIGHT", "DATA")
_VERSION = re.compile(r"0?\.[567]")
_NUMBER = re.compile(r"[0-9]{1,19}")
_REAL = re.compile(r"[-+0-9.eE]{1,32}")
_NAME = re.compile(r"[\x21-\x7e]{1,64}")

ERRORS = HeaderErrors("PCD header", "Export the file again with a tool that writes PCD version 0.7.")


@dataclass(frozen=True)
class Field:
    """One column, or several of one type: its name, numpy type and count."""

    name: str
    dtype: str
    count: int

    @property
    def size(self) -> int:
        """Bytes in a binary row."""
        return int(self.dtype[1]) * self.count


@dataclass
class Header:
    """What a header declares; ``size`` is the number of its bytes."""

    fields: tuple[Field, ...]
    width: int
    height: int
    viewpoint: str
    encoding: str
    comments: list[str]
    metadata: dict[str, str]
    size: int

    @property
    def count(self) -> int:
        """Number of points."""
        return self.width * self.height

    @property
    def coordinates(self) -> tuple[str, str, str]:
        """The names of the coordinates as spelled."""
        found: dict[str, str] = {}
        for field in sorted(self.fields, key=lambda field: field.name.isupper()):
            if field.count == 1:
                found.setdefault(field.name.lower(), field.name)
        return found["x"], found["y"], found["z"]

    @property
    def stride(self) -> int:
        """Bytes of a binary row."""
        return sum(field.size for field in self.fields)

    def row_dtype(self) -> np.dtype[Any]:
        """Return the type of a binary row; fields are named by their number, because padding repeats a name."""
        return np.dtype([(str(i), "<" + field.dtype, (field.count,)) for i, field in enumerate(self.fields)])


def read_header(file: BinaryIO) -> Header:
    """Parse the header at the start of a file that is open at its first byte.

    Raises
    ------
    FormatError
        ``bad_header``, ``header_too_long``, ``too_many_elements``, ``duplicate_property``,
        ``unsupported_type`` or ``missing_coordinates``.
    """
    entries: dict[str, list[str]] = {}
    comments: list[str] = []
    metadata: dict[str, str] = {}
    size = number = 0
    while "DATA" not in entries:
        number += 1
        line = file.readline(MAX_FIELD_LINE_BYTES + 3)
        size += len(line)
        _check_length(line, size, number)
        text = line.decode("utf-8", "surrogateescape").strip()
        if text.startswith("#"):
            note = text[1:].removeprefix(" ")
            match = METADATA.fullmatch(note)
            if match:
                metadata[match[1]] = match[2]
            elif not (number == 1 and note.startswith(".PCD")):
                comments.append(note)
        elif text:
            keyword, *words = text.split()
            if keyword not in _KEYWORDS:
                ERRORS.wrong(f"line {number}, {shown(text)}, begins with none of {', '.join(_KEYWORDS)}")
            if keyword in entries:
                ERRORS.wrong(f"there are two lines {keyword}")
            entries[keyword] = words
    missing = [keyword for keyword in _REQUIRED if keyword not in entries]
    if missing:
        ERRORS.wrong(f"there is no line {', '.join(missing)}")
    if not _VERSION.fullmatch("".join(entries.get("VERSION", ["0.7"]))):
        ERRORS.wrong("the version must be 0.7")
    header = Header(
        fields=_fields(entries),
        width=_number(entries, "WIDTH"),
        height=_number(entries, "HEIGHT"),
        viewpoint=_viewpoint(entries),
        encoding=_one(entries, "DATA"),
        comments=comments,
        metadata=metadata,
        size=size,
    )
    if header.encoding not in ENCODINGS:
        ERRORS.wrong(f"the data must be one of {', '.join(ENCODINGS)}, not {shown(header.encoding)}")
    if "POINTS" in entries and _number(entries, "POINTS") != header.count:
        ERRORS.wrong(f"POINTS is {entries['POINTS'][0]}, WIDTH times HEIGHT is {header.count}")
    if header.count >= 2**63:
        ERRORS.wrong("WIDTH times HEIGHT is too large a number")
    return header


def _check_length(line: bytes, size: int, number: int) -> None:
    limit = MAX_LINE_BYTES if line.lstrip().startswith(b"#") else MAX_FIELD_LINE_BYTES
    if len(line.rstrip(b"\r\n")) > limit:
        ERRORS.too_long(f"Line {number} of the header", limit)
    if size > MAX_COMMENT_BYTES:
        ERRORS.too_long("The header", MAX_COMMENT_BYTES)
    if not line.endswith(b"\n"):
        raise FormatError(
            "The PCD header has no DATA line.",
            code="bad_header",
            hint="The file may be cut off: copy or export it again.",
        )


def _one(entries: dict[str, list[str]], keyword: str) -> str:
    if len(entries[keyword]) != 1:
        ERRORS.wrong(f"the line {keyword} needs one value")
    return entries[keyword][0]


def _number(entries: dict[str, list[str]], keyword: str) -> int:
    word = _one(entries, keyword)
    if not _NUMBER.fullmatch(word):
        ERRORS.wrong(f"{keyword} must be a whole number of 0 or more, not {shown(word)}")
    return int(word)


def _viewpoint(entries: dict[str, list[str]]) -> str:
    words = entries.get("VIEWPOINT", ["0", "0", "0", "1", "0", "0", "0"])
    if len(words) != 7 or not all(_REAL.fullmatch(word) for word in words):
        ERRORS.wrong("VIEWPOINT needs seven numbers")
    return " ".join(words)


def _fields(entries: dict[str, list[str]]) -> tuple[Field, ...]:
    names = entries["FIELDS"]
    counts = entries.get("COUNT", ["1"] * len(names))
    columns = (entries["SIZE"], entries["TYPE"], counts)
    if any(len(column) != len(names) for column in columns):
        ERRORS.wrong("FIELDS, SIZE, TYPE and COUNT differ in their number of values")
    if len(names) > MAX_FIELDS:
        _too_many(f"{len(names)} fields; at most {MAX_FIELDS} are read", MAX_FIELDS, len(names))
    fields: list[Field] = []
    for name, size, kind, count in zip(names, *columns, strict=True):
        if not _NAME.fullmatch(name):
            ERRORS.wrong("names have 1 to 64 printable ASCII characters")
        if name != PADDING and any(name == field.name for field in fields):
            raise FormatError(
                f"The PCD has two fields named {shown(name)}.",
                code="duplicate_property",
                hint="Rename or remove one of them.",
            )
        if kind + size not in _TYPES:
            raise FormatError(
                f"Field {shown(name)} has the type {shown(kind)} of size {shown(size)}, which PCD does not allow.",
                code="unsupported_type",
                hint="The types are I and U of 1, 2, 4 or 8 bytes, and F of 4 or 8.",
            )
        if not _NUMBER.fullmatch(count) or int(count) == 0:
            ERRORS.wrong(f"the count of {shown(name)} must be a whole number of 1 or more, not {shown(count)}")
        fields.append(Field(name, _TYPES[kind + size], int(count)))
    values = sum(field.count for field in fields)
    if values > MAX_VALUES:
        _too_many(f"{values} values a point; at most {MAX_VALUES} are read", MAX_VALUES, values)
    found = {field.name.lower() for field in fields if field.count == 1}
    missing = [name for name in "xyz" if name not in found]
    if missing:
        seen = ", ".join(shown(name) for name in names[:8]) or "none"
        raise FormatError(
            f"The PCD has no field {', '.join(missing)} of one value a point; its fields are: {seen}.",
            code="missing_coordinates",
            hint="Name the coordinates x, y and z.",
        )
    return tuple(fields)


def _too_many(what: str, limit: int, actual: int) -> NoReturn:
    raise FormatError(
        f"The PCD has {what}.",
        code="too_many_elements",
        hint="Export fewer per-point fields.",
        limit=limit,
        actual=actual,
    )


def header_bytes(
    fields: Iterable[Field], width: int, height: int, viewpoint: str, encoding: str, comments: Iterable[str]
) -> bytes:
    """Return the header of a PCD; `comments` are lines that begin with ``#``."""
    fields = list(fields)
    lines = [FIRST_LINE, *comments, "VERSION 0.7"]
    lines.append("FIELDS " + " ".join(field.name for field in fields))
    lines.append("SIZE " + " ".join(field.dtype[1] for field in fields))
    lines.append("TYPE " + " ".join(field.dtype[0].upper() for field in fields))
    lines.append("COUNT " + " ".join(str(field.count) for field in fields))
    lines += [f"WIDTH {width}", f"HEIGHT {height}", f"VIEWPOINT {viewpoint}", f"POINTS {width * height}"]
    return ("\n".join([*lines, f"DATA {encoding}"]) + "\n").encode("utf-8", "surrogateescape")
