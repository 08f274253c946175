"""E57: all scans of a file as one cloud in its common frame, and back into scans with their poses."""

from __future__ import annotations

import re
from typing import Any, BinaryIO, NoReturn

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError, check_available, shown
from ..flavours import E57Flavour
from ..limits import Limits, check_count, check_enough
from ..point_cloud import PointCloud, checked
from ..roles import CHANNELS, SCAN_INDEX
from .buffers import Buffers
from .header import Header, Scan, read_scans

AXES = ("cartesianX", "cartesianY", "cartesianZ")
NORMALS = ("nor:normalX", "nor:normalY", "nor:normalZ")
COLOURS = dict(zip(("colorRed", "colorGreen", "colorBlue"), CHANNELS, strict=True))
_METADATA = re.compile(r"^pcdnf ([a-z0-9_]{1,64}): (.*)$", re.MULTILINE)
_INVALID = ("cartesianInvalidState", "sphericalInvalidState")
_DIRECTION_ONLY = 1
"""State of a point of which only the direction is valid; 2 is a point of which nothing is."""
STANDARD = {"intensity", "rowIndex", "columnIndex", "returnIndex", "returnCount", "timeStamp"}
STANDARD |= {"isColorInvalid", "isIntensityInvalid", "isTimeStampInvalid"}


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
    header = read_scans(file, size)
    scans = header.scans
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
    return checked(_cloud(header, scans, points, columns), limits)


def _values(path: str, scans: list[Scan]) -> list[dict[str, NDArray[Any]]]:
    """Return the fields of each scan as the library reads them."""
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
    """Return the coordinates of a scan in the common frame, (n, 3); NaN for points that are marked as invalid."""
    first, second, third = (values[name].astype(np.float64) for name in scan.coordinates)
    local = np.stack([first, second, third], axis=1)
    if scan.coordinates != AXES:
        flat = first * np.cos(third)
        local = np.stack([flat * np.cos(second), flat * np.sin(second), first * np.sin(third)], axis=1)
    for name in _INVALID:
        if name in values:
            local[values[name] != 0] = np.nan
    moved: NDArray[np.float64] = local @ rotation_matrix(scan.rotation).T + np.array(scan.translation)
    return moved


def rotation_matrix(rotation: tuple[float, float, float, float]) -> NDArray[np.float64]:
    """Return the rotation matrix (3, 3) of a unit quaternion (w, x, y, z)."""
    w, x, y, z = rotation
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _cloud(header: Header, scans: list[Scan], points: NDArray[Any], columns: dict[str, NDArray[Any]]) -> PointCloud:
    notes = [*header.notes]
    sizes = [scan.count for scan in scans]
    index = np.repeat(np.arange(len(scans)), sizes).astype(np.uint16)
    normals = None
    if set(NORMALS) <= columns.keys():
        local = np.stack([columns.pop(name) for name in NORMALS], axis=1)
        kind = np.float32 if local.dtype.itemsize <= 4 else np.float64
        normals = np.concatenate(
            [local[index == scan] @ rotation_matrix(one.rotation).T for scan, one in enumerate(scans)]
        ).astype(kind)
    directions = sum(int((columns[name] == _DIRECTION_ONLY).sum()) for name in _INVALID if name in columns)
    if directions:
        notes.append(
            f"{directions} points have a direction but no distance; the result keeps their rows without coordinates."
        )
    for name in ({name for scan in scans for name in scan.coordinates} | {*_INVALID}) & columns.keys():
        del columns[name]
    if any(scan.coordinates != AXES for scan in scans):
        notes.append("Spherical coordinates were converted to cartesian ones, which the result stores.")
    partly = [name for name in columns if any(name not in {one.name for one in scan.fields} for scan in scans)]
    if partly:
        notes.append(f"Not every scan has {', '.join(map(shown, partly))}; the others have NaN or 0 there.")
    attributes = {COLOURS.get(name, name): column for name, column in columns.items()}
    if len(scans) > 1:
        attributes[SCAN_INDEX] = index
    return PointCloud(
        points=points,
        normals=normals,
        attributes=attributes,
        metadata=dict(_METADATA.findall(scans[0].description)),
        flavour=E57Flavour(tuple(scans), header.coordinate_system, header.brightest, header.facts),
        warnings=notes,
    )
