"""LAS and LAZ: every dimension, record and bit is carried; coordinates stay on the file's own grid."""

from __future__ import annotations

import struct
from dataclasses import replace
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..attributes import numeric_attributes
from ..errors import FormatError, shown
from ..flavours import LasFlavour
from ..limits import Limits, check_count, check_enough
from ..point_cloud import PointCloud, checked
from ..roles import find_normals, free_normals
from .assembly import LARGEST_RECORD, Assembly
from .columns import fits_copc, las_attributes, las_columns, new_flavour
from .copc import is_copc, octree, without_copc
from .grid import Grid, grid_for, snapped
from .header import Header, Record, is_scaled, read_header
from .laz import inflated
from .points import pack, record_dtype, unpack

_NOTES = b"pcdnf"
_METADATA, _COMMENTS = 1, 2
_WKT, _GEOTIFF = 2112, 34735
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
    found = find_normals(name for name in columns if columns[name].dtype.kind == "f" and name not in scaled)
    found = found if found and _are_floats(columns, found, scaled) else None
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
            normals=found or free_normals(columns, ("NormalX", "NormalY", "NormalZ")),
        ),
        warnings=warnings,
    )


def _are_floats(columns: dict[str, NDArray[Any]], names: tuple[str, str, str], scaled: list[str]) -> bool:
    """Whether three dimensions are there, of one float type."""
    kinds = {columns[name].dtype.str[1:] if name in columns and columns[name].ndim == 1 else "" for name in names}
    return kinds in ({"f4"}, {"f8"}) and not set(names) & set(scaled)


def write_las(file: BinaryIO, cloud: PointCloud, *, compressed: bool, copc: bool = False) -> list[str]:
    """Write a cloud as it came, or as LAS 1.4 when it came as something else.

    Parameters
    ----------
    file : seekable binary file
    cloud : PointCloud
    compressed : bool
        Whether to write a LAZ.
    copc : bool
        Whether to write the LAZ as a COPC; the points must be in the order of :func:`arranged`.

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
    known = cloud.flavour if isinstance(cloud.flavour, LasFlavour) else None
    if known is None or (copc and not fits_copc(known)):
        attributes, told = las_attributes(attributes, cloud.brightest)
        flavour = new_flavour(attributes, compressed, known)
    else:
        flavour, told = (known, []) if copc else _without_index(known)
    grid, refined = grid_for(cloud.points, known.grid if known else None)
    columns, extras, ranges = las_columns(cloud, attributes, flavour)
    dtype = record_dtype(flavour.point_format, extras)
    if dtype.itemsize > LARGEST_RECORD:
        raise FormatError(
            f"A point of this cloud takes {dtype.itemsize} bytes; LAS holds {LARGEST_RECORD}.",
            code="cannot_store",
            hint="Write an NPZ instead.",
        )
    rows = np.zeros(len(cloud), dtype)
    for axis, values in zip("XYZ", snapped(cloud.points, grid).T, strict=True):
        rows[axis] = values
    left = pack(rows, columns, flavour.point_format, extras)
    assert not left, "every column that fits no field was given an extra dimension"
    assembly = Assembly(flavour, grid, extras, rows, [*flavour.records, *_notes(cloud)])
    if copc:
        assembly.write_copc(file, octree(cloud.points, grid))
        notes += _without_wkt(assembly.records)
    elif compressed:
        assembly.write_laz(file)
    else:
        assembly.write_las(file)
    return notes + told + ranges + refined


def _without_index(flavour: LasFlavour) -> tuple[LasFlavour, list[str]]:
    """Return the flavour without the index of a COPC, which is only valid for the input file."""
    if not is_copc(flavour.records):
        return flavour, []
    records, tail, count = without_copc(flavour.records, flavour.tail)
    header = bytearray(flavour.header)
    struct.pack_into("<I", header, 243, count)
    note = "The index of the COPC was left out, as it holds for that file only; name the result .copc.laz to get one."
    return replace(flavour, header=bytes(header), records=records, tail=tail), [note]


def _without_wkt(records: list[Record]) -> list[str]:
    """Return a note where a COPC has its coordinate system as GeoTIFF keys alone."""
    numbers = {record.number for record in records if record.user == b"LASF_Projection"}
    if _GEOTIFF not in numbers or _WKT in numbers:
        return []
    return ["The coordinate system is stored as GeoTIFF keys; readers of COPC may look for WKT only."]


def arranged(cloud: PointCloud) -> tuple[PointCloud, list[str]]:
    """Return the cloud in the order that a COPC requires, and a note on that."""
    known = cloud.flavour.grid if isinstance(cloud.flavour, LasFlavour) else None
    order = octree(cloud.points, grid_for(cloud.points, known)[0]).order
    if np.array_equal(order, np.arange(len(order))):
        return cloud, []
    return cloud.only(order), ["A COPC holds its points by the nodes of an octree: their order is another one."]


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
