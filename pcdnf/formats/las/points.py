"""The point records of LAS: the fields of each point format, values packed into bits, and extra dimensions.

LAS 1.4 R15, sections 2.6 and 2.7 (tables 7 to 24).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

_OLD = (
    ("X", "<i4"), ("Y", "<i4"), ("Z", "<i4"), ("intensity", "<u2"), ("returns", "u1"), ("class", "u1"),
    ("scan_angle_rank", "i1"), ("user_data", "u1"), ("point_source_id", "<u2"),
)  # fmt: skip
_NEW = (
    ("X", "<i4"), ("Y", "<i4"), ("Z", "<i4"), ("intensity", "<u2"), ("returns", "u1"), ("flags", "u1"),
    ("classification", "u1"), ("user_data", "u1"), ("scan_angle", "<i2"), ("point_source_id", "<u2"),
    ("gps_time", "<f8"),
)  # fmt: skip
_TIME = (("gps_time", "<f8"),)
_COLOUR = (("red", "<u2"), ("green", "<u2"), ("blue", "<u2"))
_NIR = (("nir", "<u2"),)
_WAVE = (("wave_packet", "u1", (29,)),)

RECORDS: dict[int, tuple[Any, ...]] = {
    0: _OLD,
    1: _OLD + _TIME,
    2: _OLD + _COLOUR,
    3: _OLD + _TIME + _COLOUR,
    4: _OLD + _TIME + _WAVE,
    5: _OLD + _TIME + _COLOUR + _WAVE,
    6: _NEW,
    7: _NEW + _COLOUR,
    8: _NEW + _COLOUR + _NIR,
    9: _NEW + _WAVE,
    10: _NEW + _COLOUR + _NIR + _WAVE,
}
"""The standard fields of each point format, as numpy describes records."""

_Bits = dict[str, tuple[tuple[str, int], ...]]
_OLD_BITS: _Bits = {
    "returns": (("return_number", 3), ("number_of_returns", 3), ("scan_direction_flag", 1), ("edge_of_flight_line", 1)),
    "class": (("classification", 5), ("synthetic", 1), ("key_point", 1), ("withheld", 1)),
}
_NEW_BITS: _Bits = {
    "returns": (("return_number", 4), ("number_of_returns", 4)),
    "flags": (
        ("synthetic", 1), ("key_point", 1), ("withheld", 1), ("overlap", 1), ("scanner_channel", 2),
        ("scan_direction_flag", 1), ("edge_of_flight_line", 1),
    ),
}  # fmt: skip

EXTRA_TYPES = ("u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f4", "f8")
"""Types of extra dimensions; their codes count from 1, arrays of two from 11, of three from 21."""

EXTRA_ENTRY = struct.Struct("<2sBB32s4s24s24s24s24s24s32s")
"""One extra dimension: reserved, type, options, name, unused, no data, min, max, scale, offset, description."""

SCALED = 0b11000
"""Bits of the options that say that the stored values are scaled and shifted."""


def bits_of(point_format: int) -> _Bits:
    """Return the fields of a point format that hold several values: (name, bits) of each, from the lowest bit up."""
    return _NEW_BITS if point_format >= 6 else _OLD_BITS


@dataclass(frozen=True)
class Extra:
    """An extra dimension: its name, its type in a record, and its entry in the file's list of them."""

    name: str
    dtype: str
    count: int
    entry: bytes

    @property
    def size(self) -> int:
        """Bytes in a record."""
        return np.dtype(self.dtype).itemsize * self.count


def new_extra(name: str, dtype: np.dtype[Any]) -> Extra:
    """Return an extra dimension with one value for each point."""
    kind = dtype.str[1:]
    entry = EXTRA_ENTRY.pack(b"", EXTRA_TYPES.index(kind) + 1, 0, name.encode()[:32], b"", b"", b"", b"", b"", b"", b"")
    return Extra(name, "<" + kind, 1, entry)


def record_dtype(point_format: int, extras: tuple[Extra, ...]) -> np.dtype[Any]:
    """Return the type of a record; extra dimensions are named by their number, because a file may repeat a name."""
    fields = [*RECORDS[point_format]]
    for number, extra in enumerate(extras):
        fields.append(
            (f"extra {number}", extra.dtype, (extra.count,)) if extra.count > 1 else (f"extra {number}", extra.dtype)
        )
    return np.dtype(fields)


def unpack(rows: NDArray[Any], point_format: int, extras: tuple[Extra, ...]) -> dict[str, NDArray[Any]]:
    """Every value of the records but the coordinates, as native columns by name."""
    columns: dict[str, NDArray[Any]] = {}
    packed = bits_of(point_format)
    for name, *_ in RECORDS[point_format][3:]:
        if name in packed:
            shift = 0
            for part, width in packed[name]:
                columns[part] = (rows[name] >> shift) & ((1 << width) - 1)
                shift += width
        else:
            columns[name] = np.ascontiguousarray(rows[name], rows[name].dtype.newbyteorder("="))
    for number, extra in enumerate(extras):
        column = rows[f"extra {number}"]
        columns[extra.name] = np.ascontiguousarray(column, column.dtype.newbyteorder("="))
    return columns


def pack(
    rows: NDArray[Any], columns: dict[str, NDArray[Any]], point_format: int, extras: tuple[Extra, ...]
) -> dict[str, NDArray[Any]]:
    """Store columns in records; those that do not fit their field are returned."""
    left = dict(columns)
    packed = bits_of(point_format)
    for name, *_ in RECORDS[point_format][3:]:
        if name in packed:
            shift = 0
            for part, width in packed[name]:
                if part in left and _fits(left[part], 0, (1 << width) - 1):
                    rows[name] |= (left.pop(part).astype(np.uint8) << shift).astype(np.uint8)
                shift += width
        elif name in left:
            target = rows[name]
            bounds = np.iinfo(target.dtype) if target.dtype.kind in "iu" else None
            same_shape = left[name].shape == target.shape
            if same_shape and (bounds is None or _fits(left[name], int(bounds.min), int(bounds.max))):
                target[...] = left.pop(name)
    for number, extra in enumerate(extras):
        if extra.name in left:
            rows[f"extra {number}"] = left.pop(extra.name)
    return left


def _fits(column: NDArray[Any], least: int, most: int) -> bool:
    whole = column.dtype.kind in "iub"
    return whole and (column.size == 0 or (int(column.min()) >= least and int(column.max()) <= most))
