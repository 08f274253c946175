"""PLY: text and both binary forms, read with every size checked before memory is taken for it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, BinaryIO, NoReturn

import numpy as np
from numpy.typing import NDArray

from ..comments import note_lines
from ..errors import FormatError, shown
from ..flavours import Block, PlyFlavour
from ..limits import Limits, check_count, check_enough
from ..point_cloud import PointCloud, checked
from ..roles import COORDINATES, NORMALS, SPLAT, column_name, find_coordinates, find_normals, free_normals
from .columns import Column, ply_columns
from .elements import BYTE_ORDERS, TYPES, Element
from .header import ERRORS, Header, header_bytes, read_header
from .lists import scalar_rows, skip_lists
from .text import TextBody, write_rows

Rows = NDArray[Any]
"""One structured row a vertex."""

_ROWS_PER_WRITE = 1 << 18


def read_ply(file: BinaryIO, size: int, limits: Limits) -> PointCloud:
    """Read the vertices of a PLY.

    Parameters
    ----------
    file : seekable binary file
        Open at its first byte.
    size : int
        Bytes of the file.
    limits : Limits
        Bounds on points, and what to do with rows that are not finite.

    Raises
    ------
    FormatError
        With the code of what is wrong.
    """
    header = read_header(file)
    check_count(header.vertex.count, limits)
    check_enough(header.vertex.count, limits)
    body = _read_text(file, header, size) if header.encoding == "ascii" else _read_binary(file, header, size)
    return checked(_cloud(header, body), limits)


@dataclass
class Body:
    """The vertices of a file, its other elements before and after them, and rows that its header does not declare."""

    rows: Rows = field(default_factory=lambda: np.empty(0, np.void))
    before: list[Block] = field(default_factory=list)
    after: list[Block] = field(default_factory=list)
    is_longer: bool = False


def _read_text(file: BinaryIO, header: Header, size: int) -> Body:
    shortest = header.size - 1 + sum(2 * element.count * len(element.properties) for element in header.elements)
    if shortest > size:
        _truncated(header, shortest, size)
    text, body = TextBody(file, header.newline), Body()
    blocks = body.before
    for element in header.elements:
        if element is header.vertex:
            body.rows, blocks = text.read(element), body.after
        else:
            blocks.append(Block(element.name, tuple(element.lines()), _ended(text.skip(element))))
    body.is_longer = text.remaining()
    return body


def _ended(text: bytes) -> bytes:
    return text if not text or text.endswith(b"\n") else text + b"\n"


def _read_binary(file: BinaryIO, header: Header, size: int) -> Body:
    least = header.size + sum(element.count * element.least_stride for element in header.elements)
    exact = not any(element.has_list for element in header.elements)
    if least > size:
        _truncated(header, least, size, exact=exact)
    byte_order = BYTE_ORDERS[header.encoding]
    position, body = header.size, Body()
    blocks = body.before
    for element in header.elements:
        file.seek(position)
        start = position
        if element.has_list:
            data = file.read()
            position += skip_lists(data, element, byte_order)
        else:
            position += element.count * element.least_stride
        if position > size:
            _truncated(header, position, size)
        if element is header.vertex:
            rows = scalar_rows(data, element, byte_order) if element.has_list else _read_rows(file, element, byte_order)
            body.rows, blocks = rows, body.after
        else:
            file.seek(start)
            blocks.append(Block(element.name, tuple(element.lines()), file.read(position - start)))
    if position != size:
        hint = "Correct the counts in the header, or remove what follows the last element."
        ERRORS.trailing(position, size, hint=hint)
    return body


def _read_rows(file: BinaryIO, element: Element, byte_order: str) -> Rows:
    rows = np.fromfile(file, element.row_dtype(byte_order), element.count)
    if len(rows) < element.count:
        raise FormatError(
            f"The file ended after {len(rows)} of {element.count} vertices while it was read.",
            code="truncated",
            hint="Another program may be writing it: wait until that has ended.",
            limit=element.count,
            actual=len(rows),
        )
    return rows


def _truncated(header: Header, declared: int, size: int, *, exact: bool = False) -> NoReturn:
    ERRORS.truncated(declared, size, contents=f"{header.vertex.count} vertices", exact=exact)


def _cloud(header: Header, body: Body) -> PointCloud:
    """Columns into their roles."""
    rows = body.rows
    types = {prop.name: TYPES[prop.type] for prop in header.vertex.scalars}
    warnings = _warnings(header, body)
    coordinates = find_coordinates(types) or COORDINATES
    if any(types[name][0] != "f" for name in coordinates):
        warnings.append("The coordinates are stored as integers; the result stores them as float64.")
    points = _stacked(rows, coordinates, types, np.dtype(np.float64))
    found = find_normals(types)
    partial = [name for name in types for names in NORMALS if name.lower() in names]
    normals = None
    if found:
        normals = _stacked(rows, found, types, points.dtype)
        if any(types[name][0] != "f" for name in found):
            warnings.append(f"The normals are stored as integers; the result stores them as {points.dtype}.")
    elif partial:
        warnings.append(f"Normals need three components; {', '.join(partial)} were kept as other properties.")
    taken = {*coordinates, *(found or ())}
    return PointCloud(
        points=points,
        normals=normals,
        attributes={
            column_name(name, types): np.ascontiguousarray(rows[name], rows[name].dtype.newbyteorder("="))
            for name in types
            if name not in taken
        },
        comments=header.comments,
        obj_info=header.obj_info,
        metadata=header.metadata,
        flavour=PlyFlavour(
            header.encoding,
            tuple((prop.name, prop.type) for prop in header.vertex.scalars),
            found or free_normals(types),
            tuple(body.before),
            tuple(body.after),
            coordinates,
        ),
        warnings=warnings,
    )


def _warnings(header: Header, body: Body) -> list[str]:
    """Return warnings on what was not read, and on Gaussian splats."""
    warnings = []
    names = {prop.name for prop in header.vertex.properties}
    lists = [shown(prop.name) for prop in header.vertex.properties if prop.length_type]
    if lists:
        warnings.append(f"The lists {', '.join(lists)} of the vertices were left out: only single values are kept.")
    if body.is_longer:
        warnings.append("The file has more rows than its header declares; these were left out.")
    if names >= SPLAT:
        warnings.append(
            "The file holds Gaussian splats. Their centres move; their scales, rotations and colours stay as they "
            "are, so the picture they make may change."
        )
    return warnings


def _stacked(rows: Rows, names: tuple[str, str, str], types: dict[str, str], if_integer: np.dtype[Any]) -> NDArray[Any]:
    """Three columns as (N, 3), in the widest of their float types."""
    kinds = [np.dtype(types[name]) for name in names]
    dtype = np.result_type(*kinds) if all(kind.kind == "f" for kind in kinds) else if_integer
    stacked = np.empty((len(rows), 3), dtype)
    for axis, name in enumerate(names):
        stacked[:, axis] = rows[name]
    return stacked


def write_ply(file: BinaryIO, cloud: PointCloud) -> list[str]:
    """Write a cloud as it came, or as binary little-endian when it came as something else.

    Returns
    -------
    list of str
        What could not be carried over.

    Raises
    ------
    FormatError
        ``cannot_store``.
    """
    columns, notes = ply_columns(cloud)
    flavour = cloud.flavour if isinstance(cloud.flavour, PlyFlavour) else PlyFlavour()
    encoding, before, after = flavour.encoding, flavour.before, flavour.after
    if (before or after) and cloud.dropped.size:
        names = ", ".join(shown(block.name) for block in (*before, *after))
        notes.append(f"Some vertices were left out, and with them the elements that refer to vertices: {names}.")
        before = after = ()
    recorded = [f"pcdnf {key}: {value}" for key, value in cloud.metadata.items()]
    lines = [*note_lines("comment", [*cloud.comments, *recorded]), *note_lines("obj_info", cloud.obj_info)]
    around = [[line for block in blocks for line in block.lines] for blocks in (before, after)]
    file.write(header_bytes(encoding, len(cloud), [(name, spelled) for name, spelled, _ in columns], lines, *around))
    file.write(b"".join(block.body for block in before))
    _write_rows(file, columns, encoding)
    file.write(b"".join(block.body for block in after))
    return notes


def _write_rows(file: BinaryIO, columns: list[Column], encoding: str) -> None:
    arrays = [column.astype(TYPES[spelled], copy=False) for _, spelled, column in columns]
    if encoding == "ascii":
        write_rows(file, arrays)
        return
    dtype = np.dtype([(name, BYTE_ORDERS[encoding] + TYPES[spelled]) for name, spelled, _ in columns])
    count = len(arrays[0])
    for start in range(0, count, _ROWS_PER_WRITE):
        rows = np.empty(min(_ROWS_PER_WRITE, count - start), dtype)
        for (name, _, _), array in zip(columns, arrays, strict=True):
            rows[name] = array[start : start + len(rows)]
        file.write(rows.tobytes())
