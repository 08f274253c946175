"""E57: all scans of a file as one cloud in its common frame, and back into scans with their poses."""

from __future__ import annotations

import hashlib
import re
import uuid
from typing import Any, BinaryIO, NoReturn

import numpy as np
from numpy.typing import NDArray

from ..attributes import CHANNELS, numeric_attributes
from ..errors import FormatError, check_available, shown
from ..flavours import E57Flavour
from ..limits import Limits, check_count, check_enough
from ..point_cloud import PointCloud, checked
from .buffers import Buffers
from .header import NORMALS_URI, Scan, read_scans

SCAN_INDEX = "scan_index"
"""The column that says which scan a point is of, where there are several."""

_AXES = ("cartesianX", "cartesianY", "cartesianZ")
_NORMALS = ("nor:normalX", "nor:normalY", "nor:normalZ")
_COLOURS = dict(zip(("colorRed", "colorGreen", "colorBlue"), CHANNELS, strict=True))
_METADATA = re.compile(r"^pcdnf ([a-z0-9_]{1,64}): (.*)$", re.MULTILINE)
_INVALID = ("cartesianInvalidState", "sphericalInvalidState")
_STANDARD = {"intensity", "rowIndex", "columnIndex", "returnIndex", "returnCount", "timeStamp"}
_STANDARD |= {"isColorInvalid", "isIntensityInvalid", "isTimeStampInvalid"}


def read_e57(file: BinaryIO, size: int, limits: Limits) -> PointCloud:
    """Read the points of all scans, moved by their poses.

    Parameters
    ----------
    file : seekable binary file
        Open at its first byte, with a name that leads to it.
    size : int
        Bytes of the file.
    limits : Limits
        Bounds on points, and what to do with rows that are not finite.

    Raises
    ------
    FormatError
        With the code of what is wrong.
    """
    scans, notes = read_scans(file, size)
    count = sum(scan.count for scan in scans)
    check_count(count, limits)
    check_enough(count, limits)
    scans = [scan for scan in scans if scan.count]
    columns: dict[str, NDArray[Any]] = {}
    start = 0
    kinds: dict[str, np.dtype[Any]] = {}
    for scan in scans:
        for field in scan.fields:
            known = kinds.get(field.name)
            kinds[field.name] = np.dtype(field.dtype) if known is None else np.promote_types(known, field.dtype)
    for name, kind in kinds.items():
        columns[name] = np.full(count, np.nan, kind) if kind.kind == "f" else np.zeros(count, kind)
    points = np.empty((count, 3))
    for scan, values in zip(scans, _values(file.name, scans), strict=True):
        stop = start + scan.count
        for name, column in values.items():
            columns[name][start:stop] = column
        points[start:stop] = _placed(scan, values)
        start = stop
    return checked(_cloud(scans, points, columns, notes), limits)


def _values(path: str, scans: list[Scan]) -> list[dict[str, NDArray[Any]]]:
    """The fields of each scan as the library reads them."""
    check_available("e57")
    from pye57 import libe57

    read = []
    try:
        image = libe57.ImageFile(path, "r")
        try:
            for scan in scans:
                node = image.root()["data3D"][scan.number]["points"]
                buffers = Buffers(image, scan.count)
                arrays = {one.name: buffers.add(one.path, np.zeros(scan.count, one.dtype)) for one in scan.fields}
                reader = node.reader(buffers.vector)
                if reader.read() != scan.count:
                    _damaged()
                reader.close()
                read.append({one.name: arrays[one.name].astype(one.dtype, copy=False) for one in scan.fields})
        finally:
            image.close()
    except (libe57.E57Exception, RuntimeError, ValueError, OverflowError, LookupError):
        _damaged()
    return read


def _damaged() -> NoReturn:
    raise FormatError(
        "The points of the E57 contradict its XML, or a checksum is wrong.",
        code="corrupt_archive",
        hint="The file is damaged: copy or export it again.",
    )


def _placed(scan: Scan, values: dict[str, NDArray[Any]]) -> NDArray[np.float64]:
    """The coordinates of a scan in the common frame, (n, 3); NaN for points that the scanner marked as invalid."""
    first, second, third = (values[name].astype(np.float64) for name in scan.coordinates)
    local = np.stack([first, second, third], axis=1)
    if scan.coordinates != _AXES:
        flat = first * np.cos(third)
        local = np.stack([flat * np.cos(second), flat * np.sin(second), first * np.sin(third)], axis=1)
    for name in _INVALID:
        if name in values:
            local[values[name] != 0] = np.nan
    moved: NDArray[np.float64] = local @ _matrix(scan.rotation).T + np.array(scan.translation)
    return moved


def _matrix(rotation: tuple[float, float, float, float]) -> NDArray[np.float64]:
    w, x, y, z = rotation
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _cloud(scans: list[Scan], points: NDArray[Any], columns: dict[str, NDArray[Any]], notes: list[str]) -> PointCloud:
    sizes = [scan.count for scan in scans]
    index = np.repeat(np.arange(len(scans)), sizes).astype(np.uint16)
    normals = None
    if set(_NORMALS) <= columns.keys():
        local = np.stack([columns.pop(name) for name in _NORMALS], axis=1)
        kind = np.float32 if local.dtype.itemsize <= 4 else np.float64
        normals = np.concatenate(
            [local[index == scan] @ _matrix(one.rotation).T for scan, one in enumerate(scans)]
        ).astype(kind)
    for name in ({name for scan in scans for name in scan.coordinates} | {*_INVALID}) & columns.keys():
        del columns[name]
    if any(scan.coordinates != _AXES for scan in scans):
        notes.append("Spherical coordinates were turned into cartesian ones, as which an E57 result stores them.")
    partly = [name for name in columns if any(name not in {one.name for one in scan.fields} for scan in scans)]
    if partly:
        notes.append(f"Not every scan has {', '.join(map(shown, partly))}; the others have NaN or 0 there.")
    attributes = {_COLOURS.get(name, name): column for name, column in columns.items()}
    if len(scans) > 1:
        attributes[SCAN_INDEX] = index
    return PointCloud(
        points=points,
        normals=normals,
        attributes=attributes,
        metadata=dict(_METADATA.findall(scans[0].description)),
        flavour=E57Flavour(tuple(scans)),
        warnings=notes,
    )


def write_e57(file: BinaryIO, cloud: PointCloud) -> list[str]:
    """Write a cloud into the scans it came from, each in its own frame, or as one scan.

    Parameters
    ----------
    file : binary file
        With a name that leads to it.

    Returns
    -------
    list of str
        What could not be carried over.

    Raises
    ------
    FormatError
        ``cannot_store`` or ``missing_extra``.
    """
    check_available("e57")
    from pye57 import libe57

    attributes, notes = numeric_attributes(cloud, "E57")
    notes += [f"E57 holds per-point values only; {shown(name)} was left out." for name in cloud.extras]
    if cloud.comments or cloud.obj_info:
        notes.append("E57 has no place for comments; they were left out.")
    scans = cloud.flavour.scans if isinstance(cloud.flavour, E57Flavour) else ()
    scans = scans or (Scan(0, len(cloud), (), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), "", "", ""),)
    index = attributes.pop(SCAN_INDEX, None) if len(scans) > 1 else None
    stored, left = _fields(attributes)
    notes += [f"E57 has no field for {shown(name)}; it was left out." for name in left]
    image = libe57.ImageFile(file.name, "w")
    try:
        _begin(image, libe57, cloud)
        data = image.root()["data3D"]
        for number, scan in enumerate(scans):
            rows = np.arange(len(cloud)) if index is None else np.flatnonzero(index == number)
            if len(rows):
                columns = {name: column[rows] for name, column in stored.items()}
                node, points, buffers = _scan_node(image, libe57, cloud, scan, rows, columns)
                data.append(node)
                writer = points.writer(buffers.vector)
                writer.write(len(rows))
                writer.close()
    finally:
        image.close()
    file.seek(0, 2)
    return notes


def _fields(attributes: dict[str, NDArray[Any]]) -> tuple[dict[str, NDArray[Any]], list[str]]:
    """Columns by the names of E57, and the names of those it has no field for."""
    names = {ours: theirs for theirs, ours in _COLOURS.items()}
    stored, left = {}, []
    for name, column in attributes.items():
        theirs = names.get(name, name)
        if (name not in names and name not in _STANDARD) or column.ndim > 1:
            left.append(name)
            continue
        kind = {"f2": "f4", "b1": "u1", "u8": "i8"}.get(column.dtype.str[1:], column.dtype.str[1:])
        stored[theirs] = column.astype(kind, copy=False)
    return stored, left


def _begin(image: Any, libe57: Any, cloud: PointCloud) -> None:
    """The nodes at the root; the file's own identifier follows from its points, so that it is the same every time."""
    image.extensionsAdd("", libe57.E57_V1_0_URI)
    image.extensionsAdd("nor", NORMALS_URI)
    root = image.root()
    root.set("formatName", libe57.StringNode(image, "ASTM E57 3D Imaging Data File"))
    root.set("guid", libe57.StringNode(image, _guid(cloud.points)))
    root.set("versionMajor", libe57.IntegerNode(image, 1))
    root.set("versionMinor", libe57.IntegerNode(image, 0))
    root.set("e57LibraryVersion", libe57.StringNode(image, libe57.E57_LIBRARY_ID))
    root.set("coordinateMetadata", libe57.StringNode(image, ""))
    root.set("data3D", libe57.VectorNode(image, True))
    root.set("images2D", libe57.VectorNode(image, True))


def _guid(points: NDArray[Any]) -> str:
    digest = hashlib.sha256(np.ascontiguousarray(points).data)
    return f"{{{uuid.uuid5(uuid.NAMESPACE_OID, digest.hexdigest())}}}"


def _scan_node(
    image: Any, libe57: Any, cloud: PointCloud, scan: Scan, rows: NDArray[Any], columns: dict[str, NDArray[Any]]
) -> tuple[Any, Any, Buffers]:
    """The node of a scan, that of its points, and the buffers to write them from."""
    turn = _matrix(scan.rotation)
    local = (cloud.points[rows].astype(np.float64) - np.array(scan.translation)) @ turn
    columns = {name: local[:, axis] for axis, name in enumerate(_AXES)} | columns
    if cloud.normals is not None:
        turned = (cloud.normals[rows] @ turn).astype(cloud.normals.dtype)
        columns |= {name: turned[:, axis] for axis, name in enumerate(_NORMALS)}
    node = libe57.StructureNode(image)
    recorded = "\n".join(f"pcdnf {key}: {value}" for key, value in cloud.metadata.items())
    kept = [line for line in scan.description.splitlines() if not line.startswith("pcdnf ")]
    node.set("guid", libe57.StringNode(image, scan.guid or _guid(local)))
    node.set("name", libe57.StringNode(image, scan.name))
    node.set("description", libe57.StringNode(image, "\n".join([*kept, recorded]).strip("\n")))
    pose = libe57.StructureNode(image)
    node.set("pose", pose)
    for part, axes, values in (("rotation", "wxyz", scan.rotation), ("translation", "xyz", scan.translation)):
        inner = libe57.StructureNode(image)
        pose.set(part, inner)
        for axis, value in zip(axes, values, strict=True):
            inner.set(axis, libe57.FloatNode(image, value))
    prototype = libe57.StructureNode(image)
    buffers = Buffers(image, len(rows))
    for name, column in columns.items():
        buffers.add(name, column)
        if column.dtype.kind == "f":
            precision = libe57.E57_SINGLE if column.dtype.itemsize == 4 else libe57.E57_DOUBLE
            prototype.set(name, libe57.FloatNode(image, 0.0, precision))
        else:
            bounds = np.iinfo(column.dtype)
            prototype.set(name, libe57.IntegerNode(image, 0, int(bounds.min), int(bounds.max)))
    points = libe57.CompressedVectorNode(image, prototype, libe57.VectorNode(image, True))
    node.set("points", points)
    return node, points, buffers
