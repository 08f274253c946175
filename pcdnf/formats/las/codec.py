"""LAS and LAZ: every dimension, record and bit is carried; coordinates stay on the file's own grid."""

from __future__ import annotations

import struct
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..attributes import numeric_attributes
from ..errors import FormatError, shown
from ..flavours import LasFlavour
from ..limits import Limits, check_count, check_enough
from ..point_cloud import PointCloud, checked
from .columns import las_columns, new_flavour, sixteen_bit_colours
from .grid import Grid, grid_for, snapped
from .header import COMPRESSED, VLR, Header, Record, is_scaled, read_header
from .laz import Compressor, inflated
from .points import EXTRA_ENTRY, Extra, pack, record_dtype, unpack

NORMAL_NAMES = (("NormalX", "NormalY", "NormalZ"), ("normal_x", "normal_y", "normal_z"), ("nx", "ny", "nz"))
"""Extra dimensions that are normals, the first ones found count; new ones take the first that are free."""

_NOTES = b"pcdnf"
_METADATA, _COMMENTS = 1, 2
_LARGEST_RECORD = 2**16 - 1
_NEWEST = 4
_ROWS_PER_WRITE = 1 << 18


def read_las(file: BinaryIO, size: int, limits: Limits) -> PointCloud:
    """Read the points of a LAS or a LAZ.

    Parameters
    ----------
    file : seekable binary file
        Open at its first byte.
    size : int
        Bytes of the file.
    limits : Limits
        Bounds on points and bytes, and what to do with rows that are not finite.

    Raises
    ------
    FormatError
        With the code of what is wrong.
    """
    header = read_header(file, size)
    check_count(header.count, limits)
    check_enough(header.count, limits)
    dtype = record_dtype(header.point_format, header.extras)
    file.seek(header.start)
    if header.compression:
        rows = np.frombuffer(inflated(file, header, size, limits), dtype)
    else:
        rows = np.fromfile(file, dtype, header.count)
        if len(rows) < header.count:
            raise FormatError(
                f"The file ended after {len(rows)} of {header.count} points while it was read.",
                code="truncated",
                hint="Another program may be writing it: wait until that has ended.",
                limit=header.count,
                actual=len(rows),
            )
    file.seek(header.end)
    return checked(_cloud(header, rows, file.read()), limits)


def _cloud(header: Header, rows: NDArray[Any], tail: bytes) -> PointCloud:
    points = np.stack(
        [rows[axis] * header.scales[index] + header.offsets[index] for index, axis in enumerate("XYZ")], axis=1
    )
    columns = unpack(rows, header.point_format, header.extras)
    scaled = [extra.name for extra in header.extras if is_scaled(extra)]
    warnings = [
        f"The dimension {shown(name)} has a scale; other formats get the whole numbers that are stored."
        for name in scaled
    ]
    found = next((names for names in NORMAL_NAMES if _are_floats(columns, names, scaled)), None)
    normals = None if found is None else np.stack([columns.pop(name) for name in found], axis=1)
    texts = {
        record.number: record.data.decode("utf-8", "replace") for record in header.records if record.user == _NOTES
    }
    lines = [line.partition(": ") for line in texts.get(_METADATA, "").splitlines()]
    return PointCloud(
        points=points,
        normals=normals,
        attributes=columns,
        comments=texts.get(_COMMENTS, "").splitlines(),
        metadata={key: value for key, _, value in lines},
        flavour=LasFlavour(
            format="laz" if header.compression else "las",
            header=header.raw,
            records=tuple(record for record in header.records if record.user != _NOTES),
            gap=header.gap,
            tail=tail,
            tail_start=header.end,
            point_format=header.point_format,
            extras=header.extras,
            grid=Grid(header.scales, header.offsets),
            normals=found or next(names for names in NORMAL_NAMES if columns.keys().isdisjoint(names)),
        ),
        warnings=warnings,
    )


def _are_floats(columns: dict[str, NDArray[Any]], names: tuple[str, str, str], scaled: list[str]) -> bool:
    """Whether three dimensions are there, of one float type."""
    kinds = {columns[name].dtype.str[1:] if name in columns and columns[name].ndim == 1 else "" for name in names}
    return kinds in ({"f4"}, {"f8"}) and not set(names) & set(scaled)


def write_las(file: BinaryIO, cloud: PointCloud, *, compressed: bool) -> list[str]:
    """Write a cloud as it came, or as LAS 1.4 when it came as something else.

    Returns
    -------
    list of str
        What could not be carried over, or was stored otherwise.

    Raises
    ------
    FormatError
        ``cannot_store``.
    """
    attributes, notes = numeric_attributes(cloud, "LAS")
    notes += [f"LAS holds per-point values only; {shown(name)} was left out." for name in cloud.extras]
    flavour = cloud.flavour if isinstance(cloud.flavour, LasFlavour) else new_flavour(attributes, compressed)
    if not isinstance(cloud.flavour, LasFlavour):
        attributes = sixteen_bit_colours(attributes)
    known = flavour.grid if isinstance(cloud.flavour, LasFlavour) else None
    grid, told = grid_for(cloud.points, known)
    notes += told
    columns, extras = las_columns(cloud, attributes, flavour)
    dtype = record_dtype(flavour.point_format, extras)
    if dtype.itemsize > _LARGEST_RECORD:
        raise FormatError(
            f"A point of this cloud takes {dtype.itemsize} bytes; LAS holds {_LARGEST_RECORD}.",
            code="cannot_store",
            hint="Write an NPZ instead.",
        )
    rows = np.zeros(len(cloud), dtype)
    for axis, values in zip("XYZ", snapped(cloud.points, grid).T, strict=True):
        rows[axis] = values
    left = pack(rows, columns, flavour.point_format, extras)
    assert not left, "every column that fits no field was given an extra dimension"
    _write_file(file, cloud, flavour, grid, extras, rows, compressed)
    return notes


def _write_file(
    file: BinaryIO,
    cloud: PointCloud,
    flavour: LasFlavour,
    grid: Grid,
    extras: tuple[Extra, ...],
    rows: NDArray[Any],
    compressed: bool,
) -> None:
    records = [*flavour.records, *_notes(cloud)]
    listed = b"".join(extra.entry or _undocumented(extra) for extra in extras)
    records += [Record(b"LASF_Spec", 4, b"", listed)] if extras else []
    compressor = None
    if compressed:
        compressor = Compressor(flavour.point_format, sum(extra.size for extra in extras))
        records.append(Record(b"laszip encoded", 22204, b"", compressor.record))
    too_long = next((record for record in records if len(record.data) > _LARGEST_RECORD), None)
    if too_long is not None:
        raise FormatError(
            f"The cloud needs {len(too_long.data)} bytes in a record of the header; LAS holds {_LARGEST_RECORD}.",
            code="cannot_store",
            hint="Remove comments or columns, or write an NPZ.",
        )
    packed = b"".join(VLR.pack(b"", one.user, one.number, len(one.data), one.description) + one.data for one in records)
    header = bytearray(flavour.header)
    start = len(header) + len(packed) + len(flavour.gap)
    struct.pack_into("<II", header, 96, start, len(records))
    struct.pack_into("<BH", header, 104, flavour.point_format | (COMPRESSED if compressed else 0), rows.dtype.itemsize)
    file.write(bytes(header) + packed + flavour.gap)
    if compressor is not None:
        compressor.write(file, rows)
    else:
        for at in range(0, len(rows), _ROWS_PER_WRITE):
            file.write(rows[at : at + _ROWS_PER_WRITE].tobytes())
    file.seek(0, 2)
    end = file.tell()
    file.write(flavour.tail)
    _fill_header(header, rows, grid, end, flavour)
    file.seek(0)
    file.write(header)
    file.seek(0, 2)


def _fill_header(header: bytearray, rows: NDArray[Any], grid: Grid, end: int, flavour: LasFlavour) -> None:
    """Counts, bounds, and where the tail went."""
    minor, count = header[25], len(rows)
    mask = 0x0F if flavour.point_format >= 6 else 0x07
    returns = np.bincount(np.clip(rows["returns"] & mask, 0, 15), minlength=16)[1:]
    if minor < _NEWEST or flavour.point_format < 6:
        struct.pack_into("<I5I", header, 107, count, *returns[:5].tolist())
    if minor == _NEWEST:
        if flavour.point_format >= 6:
            struct.pack_into("<I5I", header, 107, 0, 0, 0, 0, 0, 0)
        struct.pack_into("<Q15Q", header, 247, count, *returns.tolist())
        struct.pack_into("<Q", header, 235, end if flavour.tail else 0)
    if minor >= 3:
        (wave,) = struct.unpack_from("<Q", header, 227)
        if wave >= flavour.tail_start > 0:
            struct.pack_into("<Q", header, 227, wave - flavour.tail_start + end)
    bounds = []
    for index, axis in enumerate("XYZ"):
        for stored in (rows[axis].max(), rows[axis].min()):
            bounds.append(float(stored) * grid.scales[index] + grid.offsets[index])
    struct.pack_into("<3d3d6d", header, 131, *grid.scales, *grid.offsets, *bounds)


def _undocumented(extra: Extra) -> bytes:
    """An entry for bytes that the file did not list."""
    return EXTRA_ENTRY.pack(b"", 0, min(extra.count, 255), extra.name.encode()[:32], *[b""] * 6, b"")


def _notes(cloud: PointCloud) -> list[Record]:
    """Metadata and comments as records of our own."""
    texts = {
        _METADATA: "\n".join(f"{key}: {value}" for key, value in cloud.metadata.items()),
        _COMMENTS: "\n".join([*cloud.comments, *cloud.obj_info]),
    }
    return [
        Record(
            _NOTES, number, b"how it was made" if number == _METADATA else b"comments", text.encode("utf-8", "replace")
        )
        for number, text in texts.items()
        if text
    ]
