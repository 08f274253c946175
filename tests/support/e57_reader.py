"""A second reader of E57, by the standard (ASTM E2807-11, sections 8 and 9) and by nothing of ours or of libE57."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from tests.support.seeds import crc32c

PAGE, PAYLOAD = 1024, 1020
COMPRESSED_VECTOR, DATA_PACKET = 1, 1
Array = np.ndarray[Any, Any]


def scans(path: Path) -> list[dict[str, Array]]:
    """The columns of each scan by the names of their fields, integers as objects of any size.

    Checks the checksum of every page.
    """
    data = path.read_bytes()
    assert len(data) % PAGE == 0
    for at in range(0, len(data), PAGE):
        assert struct.unpack_from(">I", data, at + PAYLOAD)[0] == crc32c(data[at : at + PAYLOAD]), f"page {at // PAGE}"
    logical = b"".join(data[at : at + PAYLOAD] for at in range(0, len(data), PAGE))
    magic, major, minor, size, start, length, page = struct.unpack_from("<8sIIQQQQ", data)
    assert (magic, major, minor, size, page) == (b"ASTM-E57", 1, 0, len(data), PAGE)
    root = ElementTree.fromstring(logical[_logical(start) : _logical(start) + length])
    return [_columns(logical, node) for node in root.iterfind("./{*}data3D/{*}vectorChild/{*}points")]


def _logical(physical: int) -> int:
    return physical // PAGE * PAYLOAD + physical % PAGE


def _columns(logical: bytes, points: ElementTree.Element) -> dict[str, Array]:
    prototype = points.find("./{*}prototype")
    assert prototype is not None
    fields = list(prototype)
    count, at = int(points.get("recordCount", "0")), _logical(int(points.get("fileOffset", "0")))
    kind, length, first, _ = struct.unpack_from("<B7xQQQ", logical, at)
    assert kind == COMPRESSED_VECTOR
    streams = [b""] * len(fields)
    position, end = _logical(first), at + length
    while position < end:
        kind, _, less, number = struct.unpack_from("<BBHH", logical, position)
        if kind == DATA_PACKET:
            assert number == len(fields)
            sizes = struct.unpack_from(f"<{number}H", logical, position + 6)
            begin = position + 6 + 2 * number
            for field, part in enumerate(sizes):
                streams[field] += logical[begin : begin + part]
                begin += part
        position += less + 1
    return {_name(field): _decoded(field, stream, count) for field, stream in zip(fields, streams, strict=True)}


def _name(field: ElementTree.Element) -> str:
    return field.tag.rpartition("}")[2]


def _decoded(field: ElementTree.Element, stream: bytes, count: int) -> Array:
    if field.get("type") == "Float":
        return np.frombuffer(stream, "<f4" if field.get("precision") == "single" else "<f8", count)
    least, most = int(field.get("minimum", str(-(2**63)))), int(field.get("maximum", str(2**63 - 1)))
    bits = (most - least).bit_length()
    whole = int.from_bytes(stream, "little")
    mask = (1 << bits) - 1
    values = [least + ((whole >> (bits * number)) & mask) for number in range(count)]
    if field.get("type") == "ScaledInteger":
        scale, offset = float(field.get("scale", "1")), float(field.get("offset", "0"))
        return np.array([value * scale + offset for value in values])
    return np.array(values, object)
