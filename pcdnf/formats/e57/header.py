"""The header and the XML of an E57 file, checked before the library opens it. ASTM E2807.

A file is pages of 1 024 bytes, the last four of each a checksum. The XML at its end names the scans; what it declares
is compared with the size of the file here. No array is allocated.
"""

from __future__ import annotations

import math
import re
import struct
from dataclasses import dataclass, replace
from typing import BinaryIO, NoReturn
from xml.etree import ElementTree

import numpy as np

from ..errors import FormatError, shown
from ..header_errors import HeaderErrors
from .facts import Fact, read_facts

MAX_XML_BYTES = 16 * 1024**2
MAX_SCANS = 1000
MAX_FIELDS = 64

NORMALS_URI = "http://www.libe57.org/E57_NOR_surface_normals.txt"

_PREFIX = re.compile(r'xmlns:([A-Za-z_][\w.-]*)\s*=\s*"([^"]*)"')
_PAGE, _PAYLOAD = 1024, 1020
_HEADER = struct.Struct("<8sIIQQQQ")
_OWN = ("guid", "name", "description", "pose", "points")
_ROOT = (
    *("formatName", "guid", "versionMajor", "versionMinor", "e57LibraryVersion", "coordinateMetadata"),
    *("data3D", "images2D"),
)
_DERIVED = ("cartesianBounds", "sphericalBounds")
_CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ")
_SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
_INTEGERS = ("u1", "i1", "u2", "i2", "u4", "i4")

_ERRORS = HeaderErrors("E57 header", "Export the file again with a tool that writes E57 1.0, or as LAS or PLY.")


@dataclass(frozen=True)
class Field:
    """One value of each point.

    Attributes
    ----------
    name : str
        Its name without a prefix.
    dtype : str
        Its numpy type in memory.
    bits : int
        Its size in the file.
    path : str
        Its name as the file spells it.
    bounds : tuple of int, optional
        Least and greatest value of an integer.
    """

    name: str
    dtype: str
    bits: int
    path: str
    bounds: tuple[int, int] | None = None


@dataclass(frozen=True)
class Scan:
    """One scan of a file.

    Attributes
    ----------
    number : int
        Its number in the file, from 0.
    count : int
        Its points.
    fields : tuple of Field
        The values of each point.
    rotation, translation : tuple of float
        Its pose: a unit quaternion (w, x, y, z), then a shift in the unit of the file.
    guid, name, description : str
        How the file identifies it.
    facts : tuple of Fact
        Sensor, weather, times and limits.
    """

    number: int
    count: int
    fields: tuple[Field, ...]
    rotation: tuple[float, float, float, float]
    translation: tuple[float, float, float]
    guid: str
    name: str
    description: str
    facts: tuple[Fact, ...] = ()

    @property
    def coordinates(self) -> tuple[str, str, str]:
        """The names of its coordinates."""
        return _CARTESIAN if any(field.name == _CARTESIAN[0] for field in self.fields) else _SPHERICAL


@dataclass(frozen=True)
class Header:
    """What the XML of a file says.

    Attributes
    ----------
    scans : list of Scan
    coordinate_system : str
    brightest : float or None
        The highest limit of colours.
    facts : tuple of Fact
        What else the file says of itself, such as when it was made.
    notes : list of str
        Sentences on what a result does not keep.
    """

    scans: list[Scan]
    coordinate_system: str
    brightest: float | None
    facts: tuple[Fact, ...]
    notes: list[str]


def read_scans(file: BinaryIO, size: int) -> Header:
    """Read the scans of a file of `size` bytes that is open at its first byte.

    Raises
    ------
    FormatError
        ``bad_header``, ``header_too_long``, ``truncated``, ``trailing_data``, ``too_many_elements`` or
        ``missing_coordinates``.
    """
    root, prefixes = _xml(file, size)
    scans = []
    notes = []
    nodes = root.findall("./{*}data3D/{*}vectorChild")
    if len(nodes) > MAX_SCANS:
        _too_many("scans", MAX_SCANS, len(nodes))
    lost: set[str] = set()
    for number, node in enumerate(nodes):
        facts, left = read_facts(node, {*_OWN, *_DERIVED})
        lost.update(left)
        scans.append(replace(_scan(node, number, size, prefixes), facts=facts))
    if lost:
        notes.append(f"An E57 result leaves out of each scan: {', '.join(shown(name) for name in sorted(lost)[:12])}.")
    if root.findall("./{*}images2D/{*}vectorChild"):
        notes.append("The images of the E57 were left out: only points are kept.")
    limits = [fact.number("colorRedMaximum") for scan in scans for fact in scan.facts if fact.name == "colorLimits"]
    known = [limit for limit in limits if limit is not None and limit > 0]
    system = root.findtext("./{*}coordinateMetadata") or ""
    facts, _ = read_facts(root, _ROOT)
    return Header(scans, system, max(known) if known else None, facts, notes)


def _xml(file: BinaryIO, size: int) -> tuple[ElementTree.Element, dict[str, str]]:
    """Return the root of the XML, and the prefixes of extensions by their address."""
    head = file.read(_HEADER.size)
    if len(head) < _HEADER.size:
        _ERRORS.truncated(_HEADER.size, size)
    _, major, minor, length, offset, xml_length, page = _HEADER.unpack(head)
    if (major, minor, page) != (1, 0, _PAGE) or length % _PAGE:
        _ERRORS.wrong(f"version {major}.{minor} with pages of {page} bytes is not 1.0 with pages of {_PAGE}")
    if length > size:
        _ERRORS.truncated(length, size)
    if length < size:
        _ERRORS.trailing(length, size, hint="Remove what follows the end.")
    if xml_length > MAX_XML_BYTES:
        raise FormatError(
            f"The XML of the E57 has {xml_length} bytes; at most {MAX_XML_BYTES} are read.",
            code="header_too_long",
            hint="Export fewer scans at a time.",
            limit=MAX_XML_BYTES,
            actual=xml_length,
        )
    first, inside = divmod(offset, _PAGE)
    pages = -(-(inside + xml_length) // _PAYLOAD)
    if inside >= _PAYLOAD or (first + pages) * _PAGE > size:
        _ERRORS.truncated((first + pages) * _PAGE, size)
    file.seek(first * _PAGE)
    raw = file.read(pages * _PAGE)
    text = b"".join(raw[at : at + _PAYLOAD] for at in range(0, len(raw), _PAGE))[inside : inside + xml_length]
    if b"<!DOCTYPE" in text or b"<!ENTITY" in text or b"\0" in text:
        _ERRORS.wrong("its XML declares a document type, or is not UTF-8")
    try:
        prefixes = {uri: prefix for prefix, uri in _PREFIX.findall(text.decode("utf-8"))}
        return ElementTree.fromstring(text), prefixes
    except (ElementTree.ParseError, UnicodeDecodeError, ValueError):
        _ERRORS.wrong("its XML cannot be parsed")


def _scan(node: ElementTree.Element, number: int, size: int, prefixes: dict[str, str]) -> Scan:
    points = node.find("./{*}points")
    prototype = None if points is None else points.find("./{*}prototype")
    if points is None or prototype is None:
        _ERRORS.wrong(f"scan {number} has no points")
    count, offset = _whole(points.get("recordCount", "0")), _whole(points.get("fileOffset", "0"))
    if min(count, offset) < 0:
        _ERRORS.wrong(f"scan {number} has {count} points at {offset}")
    fields = tuple(_field(child, prefixes) for child in prototype)
    if len(fields) > MAX_FIELDS:
        _too_many("fields in a scan", MAX_FIELDS, len(fields))
    names = [field.name for field in fields]
    if len(set(names)) != len(names):
        _ERRORS.wrong(f"scan {number} names a field twice")
    if not any(set(wanted) <= set(names) for wanted in (_CARTESIAN, _SPHERICAL)):
        raise FormatError(
            f"Scan {number} has neither {', '.join(_CARTESIAN)} nor {', '.join(_SPHERICAL)}.",
            code="missing_coordinates",
            hint="Export the points with coordinates.",
        )
    least = offset + count * sum(field.bits for field in fields) // 8
    if least > size or offset < _HEADER.size or offset >= size:
        _ERRORS.truncated(max(least, _HEADER.size), size)
    values = {_path: _number(node, _path) for _path in ("w", "x", "y", "z")}
    shift = tuple(_number(node, axis, "translation") for axis in "xyz")
    if node.find("./{*}pose/{*}rotation") is None:
        values["w"] = 1.0
    length = math.sqrt(sum(value * value for value in values.values()))
    if not 0.99 < length < 1.01 or not all(map(math.isfinite, shift)):
        _ERRORS.wrong(f"the pose of scan {number} is not a rotation and a shift")
    unit = [value / length for value in values.values()]
    return Scan(
        number=number,
        count=count,
        fields=fields,
        rotation=(unit[0], unit[1], unit[2], unit[3]),
        translation=(shift[0], shift[1], shift[2]),
        guid=node.findtext("./{*}guid") or "",
        name=node.findtext("./{*}name") or "",
        description=node.findtext("./{*}description") or "",
    )


def _field(node: ElementTree.Element, prefixes: dict[str, str]) -> Field:
    (name, path), kind = _spelled(node, prefixes), node.get("type")
    if kind == "Float":
        double = node.get("precision", "double") == "double"
        return Field(name, "f8" if double else "f4", 64 if double else 32, path)
    if kind not in ("Integer", "ScaledInteger"):
        _ERRORS.wrong(f"field {shown(name)} is not a number")
    least, most = _whole(node.get("minimum", str(-(2**63)))), _whole(node.get("maximum", str(2**63 - 1)))
    if not -(2**63) <= least <= most < 2**63:
        _ERRORS.wrong(f"field {shown(name)} has impossible bounds")
    bits = (most - least).bit_length()
    if kind == "ScaledInteger":
        return Field(name, "f8", bits, path)
    fits = (one for one in _INTEGERS if np.iinfo(one).min <= least and most <= np.iinfo(one).max)
    return Field(name, next(fits, "i8"), bits, path, (least, most))


def _spelled(node: ElementTree.Element, prefixes: dict[str, str]) -> tuple[str, str]:
    """Return the name of a field, and its spelling; fields of the extension for normals get its usual prefix."""
    space, _, local = node.tag.removeprefix("{").rpartition("}")
    prefix = prefixes.get(space)
    path = f"{prefix}:{local}" if prefix else local
    return (f"nor:{local}" if space == NORMALS_URI else path), path


def _whole(text: str) -> int:
    if not text.removeprefix("-").isdecimal() or not text.isascii() or len(text) > 20:
        _ERRORS.wrong(f"{shown(text)} is not a whole number")
    return int(text)


def _number(node: ElementTree.Element, name: str, part: str = "rotation") -> float:
    text = node.findtext(f"./{{*}}pose/{{*}}{part}/{{*}}{name}") or "0"
    try:
        return float(text)
    except ValueError:
        _ERRORS.wrong(f"{shown(text)} in a pose is not a number")


def _too_many(what: str, limit: int, actual: int) -> NoReturn:
    raise FormatError(
        f"The E57 has {actual} {what}; at most {limit} are read.",
        code="too_many_elements",
        hint="Export fewer at a time.",
        limit=limit,
        actual=actual,
    )
