"""PCD, the format of PCL: text, binary and compressed, read with every size checked before memory is taken for it."""

from __future__ import annotations

import struct
from dataclasses import replace
from typing import Any, BinaryIO, NoReturn

import numpy as np
from numpy.typing import NDArray

from ..comments import note_lines
from ..errors import FormatError, shown
from ..flavours import PcdFlavour
from ..limits import Limits, check_count, check_enough
from ..ply.elements import SPELLINGS, Element, Property
from ..ply.text import TextBody, write_rows
from ..point_cloud import PointCloud, checked
from ..roles import find_normals, free_normals
from .columns import COLOUR_FIELDS, pcd_columns, unpacked
from .coordinates import REMAINDERS, joined
from .header import ERRORS, PADDING, Header, header_bytes, read_header
from .lzf import MAX_RATIO, decompress

MAX_PADDING_BYTES = 64 * 1024
"""Zeros after the last point: older writers fill up a page of memory."""

Columns = list[NDArray[Any]]
"""One (N, count) array a field."""

_SIZES = struct.Struct("<II")
_EXACT_IN_FLOAT64 = 2**53
_ROWS_PER_WRITE = 1 << 18


def read_pcd(file: BinaryIO, size: int, limits: Limits) -> PointCloud:
    """Read the points of a PCD.

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
    header = read_header(file)
    check_count(header.count, limits)
    check_enough(header.count, limits)
    if header.encoding == "ascii":
        columns = _read_text(file, header, size)
    elif header.encoding == "binary":
        columns = _read_binary(file, header, size)
    else:
        columns = _read_compressed(file, header, size, limits)
    return checked(_cloud(header, columns), limits)


def _read_text(file: BinaryIO, header: Header, size: int) -> Columns:
    values = sum(field.count for field in header.fields)
    least = header.size + 2 * header.count * values - 1
    if least > size:
        _truncated(header, least, size, exact=False)
    properties = []
    for number, field in enumerate(header.fields):
        spelled = SPELLINGS.get(field.dtype, "double")  # integers of 8 bytes, checked below
        properties += [Property(f"{field.name} ({number}, {part})", spelled) for part in range(field.count)]
    body = TextBody(file)
    rows = body.read(Element("points", header.count, properties))
    if body.remaining():
        raise FormatError(
            f"The file goes on after the last of the {header.count} points its header declares.",
            code="trailing_data",
            hint="Correct WIDTH and HEIGHT in the header, or remove what follows the last point.",
        )
    names = iter(prop.name for prop in properties)
    columns = []
    for field in header.fields:
        column = np.stack([rows[next(names)] for _ in range(field.count)], axis=1)
        columns.append(_whole(column, field.name, field.dtype) if field.dtype[1] == "8" else column)
    return columns


def _whole(column: NDArray[Any], name: str, dtype: str) -> NDArray[Any]:
    """Numbers of a text file whose type has 8 bytes."""
    if dtype == "f8":
        return column
    fits = (np.abs(column) <= _EXACT_IN_FLOAT64) & (column == np.rint(column))
    if dtype[0] == "u":
        fits &= column >= 0
    if not fits.all():
        row = int(np.argmin(fits.all(axis=1)))
        raise FormatError(
            f"Point {row} holds a value in {shown(name)} that is no whole number within 2^53 of its type.",
            code="bad_value",
            hint="Store such numbers in a binary PCD.",
        )
    return column.astype(dtype)


def _read_binary(file: BinaryIO, header: Header, size: int) -> Columns:
    end = header.size + header.count * header.stride
    _check_end(file, header, end, size)
    file.seek(header.size)
    rows = np.fromfile(file, header.row_dtype(), header.count)
    if len(rows) < header.count:
        _truncated(header, end, header.size + len(rows) * header.stride)
    return [np.ascontiguousarray(rows[str(number)]) for number in range(len(header.fields))]


def _read_compressed(file: BinaryIO, header: Header, size: int, limits: Limits) -> Columns:
    """Field after field, all of them packed by LZF."""
    start = header.size + _SIZES.size
    if start > size:
        _truncated(header, start, size, exact=False)
    file.seek(header.size)
    packed, inflated = _SIZES.unpack(file.read(_SIZES.size))
    expected = header.count * header.stride
    if inflated != expected:
        raise FormatError(
            f"The compressed data declares {inflated} bytes; the header declares {expected}.",
            code="bad_header",
            hint="The file is damaged: copy or export it again.",
            limit=expected,
            actual=inflated,
        )
    _check_end(file, header, start + packed, size)
    if expected > limits.max_bytes:
        raise FormatError(
            f"The PCD inflates to {expected} bytes; the limit is {limits.max_bytes}.",
            code="file_too_large",
            hint="Save fewer points or fewer fields.",
            limit=limits.max_bytes,
            actual=expected,
        )
    if expected > MAX_RATIO * packed:
        _damaged()
    file.seek(start)
    data = decompress(file.read(packed), expected)
    if data is None:
        _damaged()
    columns, at = [], 0
    for field in header.fields:
        length = header.count * field.size
        part = np.frombuffer(data, "<" + field.dtype, header.count * field.count, at)
        columns.append(part.reshape(header.count, field.count).copy())
        at += length
    return columns


def _damaged() -> NoReturn:
    raise FormatError(
        "The compressed data of the PCD contradicts itself.",
        code="corrupt_archive",
        hint="The file is damaged: copy or export it again.",
    )


def _check_end(file: BinaryIO, header: Header, end: int, size: int) -> None:
    """Check that the file ends with its last point, or with a few zeros after it."""
    if end > size:
        _truncated(header, end, size)
    file.seek(end)
    if size - end > MAX_PADDING_BYTES or any(file.read(size - end)):
        hint = "Correct WIDTH and HEIGHT in the header, or remove what follows the last point."
        ERRORS.trailing(end, size, hint=hint)


def _truncated(header: Header, declared: int, size: int, *, exact: bool = True) -> NoReturn:
    ERRORS.truncated(declared, size, contents=f"{header.count} points", exact=exact)


def _cloud(header: Header, columns: Columns) -> PointCloud:
    """Columns into their roles."""
    by_name = {field.name: column for field, column in zip(header.fields, columns, strict=True)}
    by_name.pop(PADDING, None)
    single = {name for name, column in by_name.items() if column.shape[1] == 1}
    warnings: list[str] = []
    points = _stacked(by_name, header.coordinates, "coordinates", np.dtype(np.float64), warnings)
    rests = [by_name.get(name) for name in REMAINDERS]
    if points.dtype == np.float32 and all(rest is not None and rest.dtype == np.float32 for rest in rests):
        points = joined(points, np.concatenate([by_name.pop(name) for name in REMAINDERS], axis=1))
    names = find_normals(name for name in by_name if name in single)
    normals = None if names is None else _stacked(by_name, names, "normals", points.dtype, warnings)
    attributes: dict[str, NDArray[Any]] = {}
    packed = ""
    for name, column in by_name.items():
        flat = column[:, 0] if column.shape[1] == 1 else column
        if name in COLOUR_FIELDS and flat.ndim == 1 and flat.itemsize == 4 and not packed:
            colours = unpacked(flat, alpha=name == "rgba")
            if by_name.keys().isdisjoint(colours):
                packed = name
                attributes |= colours
                continue
        attributes[name] = np.ascontiguousarray(flat)
    return PointCloud(
        points=points,
        normals=normals,
        attributes=attributes,
        comments=header.comments,
        metadata=header.metadata,
        flavour=PcdFlavour(
            header.encoding,
            tuple((field.name, field.dtype, field.count) for field in header.fields),
            header.width,
            header.height,
            header.viewpoint,
            packed,
            names or free_normals(by_name, ("normal_x", "normal_y", "normal_z")),
            header.coordinates,
        ),
        warnings=warnings,
    )


def _stacked(
    by_name: dict[str, NDArray[Any]],
    names: tuple[str, str, str],
    what: str,
    if_integer: np.dtype[Any],
    warnings: list[str],
) -> NDArray[Any]:
    """Three columns, taken out, as (N, 3) in the widest of their float types."""
    columns = [by_name.pop(name) for name in names]
    if all(column.dtype.kind == "f" for column in columns):
        return np.concatenate(columns, axis=1, dtype=np.result_type(*columns))
    warnings.append(f"The {what} are stored as integers; the result stores them as {if_integer}.")
    return np.concatenate(columns, axis=1, dtype=if_integer, casting="unsafe")


def write_pcd(file: BinaryIO, cloud: PointCloud) -> list[str]:
    """Write a cloud as it came, or as binary when it came as something else.

    Returns
    -------
    list of str
        What could not be carried over.

    Raises
    ------
    FormatError
        ``cannot_store``.
    """
    flavour = cloud.flavour if isinstance(cloud.flavour, PcdFlavour) else PcdFlavour()
    fields, columns, notes = pcd_columns(cloud, flavour)
    if flavour.height > 1 and cloud.dropped.size:
        notes.append("The cloud was a grid of points; without the rows that were left out it is a list.")
    if flavour.width * flavour.height != len(cloud):
        flavour = replace(flavour, width=len(cloud), height=1)
    recorded = [f"pcdnf {key}: {value}" for key, value in cloud.metadata.items()]
    lines = note_lines("#", [*cloud.comments, *cloud.obj_info, *recorded])
    file.write(header_bytes(fields, flavour.width, flavour.height, flavour.viewpoint, flavour.encoding, lines))
    if flavour.encoding == "ascii":
        write_rows(file, [part for column in columns for part in column.T])
    elif flavour.encoding == "binary":
        dtype = np.dtype([(str(i), "<" + field.dtype, (field.count,)) for i, field in enumerate(fields)])
        for start in range(0, len(cloud), _ROWS_PER_WRITE):
            rows = np.empty(min(_ROWS_PER_WRITE, len(cloud) - start), dtype)
            for number, column in enumerate(columns):
                rows[str(number)] = column[start : start + len(rows)]
            file.write(rows.tobytes())
    else:
        _write_compressed(file, columns)
    return notes


def _write_compressed(file: BinaryIO, columns: Columns) -> None:
    from .lzf_compress import compress

    data = np.concatenate([np.ascontiguousarray(column).reshape(-1).view(np.uint8) for column in columns])
    packed = compress(data)
    if max(len(data), len(packed)) >= 2**32:
        raise FormatError(
            f"The points take {len(data)} bytes; a compressed PCD holds at most 4 GiB.",
            code="cannot_store",
            hint="Write a binary PLY instead.",
            limit=2**32 - 1,
            actual=len(data),
        )
    file.write(_SIZES.pack(len(packed), len(data)))
    file.write(packed)
