"""The header of a LAS or LAZ file and its variable-length records: checked against the size of the file.

LAS 1.4 R15, sections 2.4 and 2.5. No array is allocated here.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np

from ..errors import FormatError, shown
from ..header_errors import HeaderErrors
from .points import EXTRA_ENTRY, EXTRA_TYPES, RECORDS, SCALED, Extra, bits_of, record_dtype

MAX_RECORDS = 1000
"""Variable-length records, of either kind."""
MAX_HEADER_BYTES = 64 * 1024**2
"""Before the first point: a coordinate system takes some kilobytes."""

VLR = struct.Struct("<2s16sHH32s")
EVLR = struct.Struct("<2s16sHQ32s")
COMPRESSED = 0x80

_SIZES = {0: 227, 1: 227, 2: 227, 3: 235, 4: 375, 5: 393}
_HIGHEST_FORMAT = {0: 1, 1: 1, 2: 3, 3: 5, 4: 10, 5: 10}
_POINTWISE = 1
_LASZIP = (b"laszip encoded", 22204)
_EXTRA_BYTES = (b"LASF_Spec", 4)
_ITEM = struct.Struct("<HHH")
_LASZIP_FIXED = struct.Struct("<HHBBHIIqqH")

_ERRORS = HeaderErrors("LAS header", "Export the file again with a tool that writes LAS 1.2 to 1.4.")


@dataclass(frozen=True)
class Record:
    """A variable-length record."""

    user: bytes
    number: int
    description: bytes
    data: bytes


@dataclass
class Header:
    """What a file declares.

    Attributes
    ----------
    raw : bytes
        The public header as it stands.
    records : list of Record
        Without those on compression and extra dimensions.
    gap : bytes
        What stands between the records and the points.
    start, end : int
        Where the points begin, and where what follows them does.
    compression : bytes
        The record on compression; empty for LAS.
    """

    raw: bytes
    point_format: int
    stride: int
    count: int
    scales: tuple[float, float, float]
    offsets: tuple[float, float, float]
    records: list[Record]
    extras: tuple[Extra, ...]
    gap: bytes
    start: int
    end: int
    compression: bytes

    @property
    def minor(self) -> int:
        """The second number of the version."""
        return self.raw[25]


def read_header(file: BinaryIO, size: int) -> Header:
    """Parse the start of a file of ``size`` bytes that is open at its first byte.

    Raises
    ------
    FormatError
        ``bad_header``, ``header_too_long``, ``truncated``, ``trailing_data`` or ``too_many_elements``.
    """
    raw = file.read(_SIZES[5])
    if len(raw) < _SIZES[0]:
        _ERRORS.truncated(_SIZES[0], size)
    major, minor = raw[24], raw[25]
    if major != 1 or minor not in _SIZES:
        _ERRORS.wrong(f"version {major}.{minor} is not one of 1.0 to 1.5")
    header_size, start, record_count = struct.unpack_from("<HII", raw, 94)
    if header_size < _SIZES[minor] or start < header_size:
        _ERRORS.wrong(f"a header of {header_size} bytes does not fit before points at byte {start}")
    if start > size:
        _ERRORS.truncated(start, size)
    if start > MAX_HEADER_BYTES or record_count > MAX_RECORDS:
        raise FormatError(
            f"The LAS header has {start} bytes and {record_count} variable-length records.",
            code="header_too_long",
            hint="Remove large records from the header.",
            limit=MAX_RECORDS if record_count > MAX_RECORDS else MAX_HEADER_BYTES,
            actual=record_count if record_count > MAX_RECORDS else start,
        )
    file.seek(0)
    head = file.read(start)
    kind, stride, count = struct.unpack_from("<BHI", head, 104)
    point_format = kind & 0x3F
    if point_format > _HIGHEST_FORMAT[minor]:
        _ERRORS.wrong(f"version 1.{minor} has no point format {point_format}")
    evlr_start = evlr_count = 0
    if minor >= 4:
        evlr_start, evlr_count, long_count = struct.unpack_from("<QIQ", head, 235)
        if count and long_count and count != long_count:
            _ERRORS.wrong(f"it declares two numbers of points, {count} and {long_count}")
        count = long_count or count
    scales, offsets = struct.unpack_from("<3d", head, 131), struct.unpack_from("<3d", head, 155)
    if not all(np.isfinite(scales)) or not all(np.isfinite(offsets)) or min(np.abs(scales)) == 0:
        _ERRORS.wrong("its scales and offsets must be finite, and no scale 0")
    records, position = _records(head, header_size, record_count)
    compression = b"".join(record.data for record in records if (record.user, record.number) == _LASZIP)
    extras = _extras(records, point_format, stride)
    header = Header(
        raw=head[:header_size],
        point_format=point_format,
        stride=stride,
        count=count,
        scales=scales,
        offsets=offsets,
        records=[record for record in records if (record.user, record.number) not in (_LASZIP, _EXTRA_BYTES)],
        extras=extras,
        gap=head[position:],
        start=start,
        end=start + count * stride,
        compression=compression if kind & COMPRESSED else b"",
    )
    if kind & COMPRESSED:
        if evlr_count and evlr_start < start:
            _ERRORS.wrong(f"its extended records begin at {evlr_start}, before its points at {start}")
        header.end = evlr_start if evlr_count else size
        _check_compression(file, header, size)
    elif header.end > size:
        _ERRORS.truncated(header.end, size)
    _check_tail(file, header, size, evlr_start, evlr_count)
    return header


def _records(head: bytes, position: int, count: int) -> tuple[list[Record], int]:
    """Read the variable-length records; return them and the position of their end."""
    records = []
    for _ in range(count):
        if position + VLR.size > len(head):
            _ERRORS.wrong("its variable-length records reach into the points")
        _, user, number, length, description = VLR.unpack_from(head, position)
        position += VLR.size
        if position + length > len(head):
            _ERRORS.wrong("its variable-length records reach into the points")
        records.append(Record(user.rstrip(b"\0"), number, description, head[position : position + length]))
        position += length
    return records, position


def _extras(records: list[Record], point_format: int, stride: int) -> tuple[Extra, ...]:
    """Read the extra dimensions that fill up a record of `stride` bytes."""
    room = stride - record_dtype(point_format, ()).itemsize
    if room < 0:
        _ERRORS.wrong(f"point format {point_format} does not fit into {stride} bytes")
    entries = b"".join(record.data for record in records if (record.user, record.number) == _EXTRA_BYTES)
    extras: list[Extra] = []
    for at in range(0, len(entries) - EXTRA_ENTRY.size + 1, EXTRA_ENTRY.size):
        entry = entries[at : at + EXTRA_ENTRY.size]
        _, code, options, raw_name, *_ = EXTRA_ENTRY.unpack(entry)
        if code > 3 * len(EXTRA_TYPES):
            _ERRORS.wrong(f"extra dimension {len(extras)} has the type {code}, which LAS does not define")
        dtype = EXTRA_TYPES[(code - 1) % len(EXTRA_TYPES)] if code else "u1"
        extra = Extra(
            name=_free(raw_name.split(b"\0")[0].decode("utf-8", "replace"), extras, point_format),
            dtype="<" + dtype,
            count=(code - 1) // len(EXTRA_TYPES) + 1 if code else max(1, options),
            entry=entry,
        )
        if extra.size > room:
            _ERRORS.wrong(f"extra dimension {shown(extra.name)} does not fit into the {stride} bytes of a point")
        room -= extra.size
        extras.append(extra)
    if room:
        extras.append(Extra(_free("extra_bytes", extras, point_format), "<u1", room, b""))
    return tuple(extras)


def _free(name: str, extras: list[Extra], point_format: int) -> str:
    taken = {"X", "Y", "Z", *(extra.name for extra in extras), *(field[0] for field in RECORDS[point_format])}
    taken |= {part for parts in bits_of(point_format).values() for part, _ in parts}
    stem = name if name.isprintable() and name.strip() else "extra"
    names = (stem if count == 1 else f"{stem}_{count}" for count in range(1, len(taken) + 2))
    return next(one for one in names if one not in taken)


def is_scaled(extra: Extra) -> bool:
    """Whether the stored values are to be scaled and shifted."""
    return bool(extra.entry) and bool(extra.entry[3] & SCALED) and extra.entry[2] != 0


def _check_compression(file: BinaryIO, header: Header, size: int) -> None:
    """Check the compression that a LAZ declares, before the library sees it."""
    data = header.compression
    if len(data) < _LASZIP_FIXED.size:
        _ERRORS.wrong("it is compressed but has no record of the compression")
    compressor, _, _, _, _, _, _, _, _, items = _LASZIP_FIXED.unpack_from(data)
    sizes = [_ITEM.unpack_from(data, at)[1] for at in range(_LASZIP_FIXED.size, len(data) - _ITEM.size + 1, _ITEM.size)]
    if len(sizes) != items or sum(sizes) != header.stride or compressor not in (1, 2, 3):
        _ERRORS.wrong("its record of the compression does not match its points")
    if compressor == _POINTWISE:
        if not header.start < header.end <= size:
            _ERRORS.truncated(max(header.end, header.start + 1), size)
        return
    if header.end > size or header.start + 8 > header.end:
        _ERRORS.truncated(max(header.end, header.start + 8), size)
    file.seek(header.start)
    (table,) = struct.unpack("<q", file.read(8))
    if table == -1:
        file.seek(header.end - 8)
        (table,) = struct.unpack("<q", file.read(8))
    if not header.start + 8 <= table <= header.end - 8:
        _ERRORS.wrong("its table of chunks is not in the file")
    file.seek(table)
    _, chunks = struct.unpack("<II", file.read(8))
    if chunks > max(header.count, 1):
        _ERRORS.wrong(f"it has {chunks} chunks for {header.count} points")


def _check_tail(file: BinaryIO, header: Header, size: int, start: int, count: int) -> None:
    """Check that extended records follow the points and end with the file."""
    position, seen = header.end, 0
    if count and start != header.end:
        _ERRORS.wrong("its extended records do not follow the points")
    if header.minor < 3 and not header.compression:
        count = 0
    while position < size and (seen < count if header.minor >= 4 else header.minor == 3):
        file.seek(position)
        head = file.read(EVLR.size)
        if len(head) < EVLR.size or seen == MAX_RECORDS:
            break
        position += EVLR.size + EVLR.unpack(head)[3]
        seen += 1
    if position > size or (header.minor >= 4 and seen < count):
        _ERRORS.truncated(max(position, size + 1), size)
    if position < size:
        _ERRORS.trailing(position, size, hint="Correct the counts in the header, or remove what follows the points.")
