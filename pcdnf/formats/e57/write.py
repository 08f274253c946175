"""A cloud as the scans of an E57, each in its own frame with its pose and what the file said of it."""

from __future__ import annotations

import hashlib
import uuid
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..attributes import numeric_attributes, renamed, with_colours
from ..colours import BYTE
from ..errors import check_available, shown
from ..flavours import E57Flavour
from ..point_cloud import PointCloud
from ..roles import SCAN_INDEX
from .buffers import Buffers
from .codec import AXES, COLOURS, NORMALS, STANDARD, rotation_matrix
from .facts import Fact, fact_node, limits
from .header import NORMALS_URI, Scan

_INVALID = "cartesianInvalidState"
_NO_POINT = 2
Columns = dict[str, NDArray[Any]]


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
    flavour = cloud.flavour if isinstance(cloud.flavour, E57Flavour) else E57Flavour()
    if not flavour.scans:
        attributes, told = with_colours(renamed(attributes), BYTE, "E57")
        notes += told
    whole = (Scan(0, len(cloud), (), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), "", "", "", _limits(attributes)),)
    scans = flavour.scans or whole
    index = attributes.pop(SCAN_INDEX, None) if len(scans) > 1 else None
    stored, left = _fields(attributes)
    if left:
        notes.append(f"E57 has no fields for further columns; left out were: {', '.join(map(shown, left))}.")
    image = libe57.ImageFile(file.name, "w")
    try:
        _begin(image, libe57, cloud, flavour)
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


def _limits(attributes: Columns) -> tuple[Fact, ...]:
    """Limits of colours and intensity, by which readers scale what they show."""
    facts = []
    if all(name in attributes and attributes[name].dtype == np.uint8 for name in COLOURS.values()):
        bounds = {f"{theirs}{end}": value for theirs in COLOURS for end, value in (("Minimum", 0), ("Maximum", BYTE))}
        facts.append(limits("colorLimits", **bounds))
    intensity = attributes.get("intensity")
    if intensity is not None and intensity.ndim == 1:
        finite = intensity[np.isfinite(intensity)].astype(np.float64)
        if finite.size:
            ends = {"intensityMinimum": float(finite.min()), "intensityMaximum": float(finite.max())}
            facts.append(limits("intensityLimits", **ends))
    return tuple(facts)


def _fields(attributes: Columns) -> tuple[Columns, list[str]]:
    """Columns by the names of E57, and the names of those it has no field for."""
    names = {ours: theirs for theirs, ours in COLOURS.items()}
    stored, left = {}, []
    for name, column in attributes.items():
        theirs = names.get(name, name)
        if (name not in names and name not in STANDARD) or column.ndim > 1:
            left.append(name)
            continue
        kind = {"f2": "f4", "b1": "u1", "u8": "i8"}.get(column.dtype.str[1:], column.dtype.str[1:])
        stored[theirs] = column.astype(kind, copy=False)
    return stored, left


def _begin(image: Any, libe57: Any, cloud: PointCloud, flavour: E57Flavour) -> None:
    """Return the nodes at the root; the file's own identifier follows from its points, so it is always the same."""
    image.extensionsAdd("", libe57.E57_V1_0_URI)
    image.extensionsAdd("nor", NORMALS_URI)
    root = image.root()
    root.set("formatName", libe57.StringNode(image, "ASTM E57 3D Imaging Data File"))
    root.set("guid", libe57.StringNode(image, _guid(cloud.points)))
    root.set("versionMajor", libe57.IntegerNode(image, 1))
    root.set("versionMinor", libe57.IntegerNode(image, 0))
    root.set("e57LibraryVersion", libe57.StringNode(image, libe57.E57_LIBRARY_ID))
    root.set("coordinateMetadata", libe57.StringNode(image, flavour.coordinate_system))
    for fact in flavour.facts:
        root.set(fact.name, fact_node(image, libe57, fact))
    root.set("data3D", libe57.VectorNode(image, True))
    root.set("images2D", libe57.VectorNode(image, True))


def _guid(points: NDArray[Any]) -> str:
    digest = hashlib.sha256(np.ascontiguousarray(points).data)
    return f"{{{uuid.uuid5(uuid.NAMESPACE_OID, digest.hexdigest())}}}"


def _scan_node(
    image: Any, libe57: Any, cloud: PointCloud, scan: Scan, rows: NDArray[Any], columns: Columns
) -> tuple[Any, Any, Buffers]:
    """Return the node of a scan, the node of its points, and the buffers to write them from."""
    turn = rotation_matrix(scan.rotation)
    local = (cloud.points[rows].astype(np.float64) - np.array(scan.translation)) @ turn
    seen = np.isfinite(local).all(axis=1)
    local = np.where(seen[:, None], local, 0)
    columns = {name: local[:, axis] for axis, name in enumerate(AXES)} | columns
    if not seen.all():
        columns[_INVALID] = np.where(seen, 0, _NO_POINT).astype(np.uint8)
    if cloud.normals is not None:
        turned = (cloud.normals[rows] @ turn).astype(cloud.normals.dtype)
        columns |= {name: turned[:, axis] for axis, name in enumerate(NORMALS)}
    node = libe57.StructureNode(image)
    recorded = "\n".join(f"pcdnf {key}: {value}" for key, value in cloud.metadata.items())
    kept = [line for line in scan.description.splitlines() if not line.startswith("pcdnf ")]
    node.set("guid", libe57.StringNode(image, scan.guid or _guid(local)))
    node.set("name", libe57.StringNode(image, scan.name))
    node.set("description", libe57.StringNode(image, "\n".join([*kept, recorded]).strip("\n")))
    for fact in (*scan.facts, _bounds(local[seen])):
        node.set(fact.name, fact_node(image, libe57, fact))
    node.set("pose", _pose(image, libe57, scan))
    prototype = libe57.StructureNode(image)
    buffers = Buffers(image, len(rows))
    for name, column in columns.items():
        buffers.add(name, column)
        prototype.set(name, _prototype(image, libe57, scan, name, column))
    points = libe57.CompressedVectorNode(image, prototype, libe57.VectorNode(image, True))
    node.set("points", points)
    return node, points, buffers


def _bounds(points: NDArray[Any]) -> Fact:
    """Return the box of a scan in its own frame."""
    low = points.min(axis=0).tolist() if len(points) else [0.0] * 3
    high = points.max(axis=0).tolist() if len(points) else [0.0] * 3
    ends = zip("xyz", low, high, strict=True)
    return limits(
        "cartesianBounds",
        **{f"{a}{e}": v for a, least, most in ends for e, v in (("Minimum", least), ("Maximum", most))},
    )


def _pose(image: Any, libe57: Any, scan: Scan) -> Any:
    pose = libe57.StructureNode(image)
    for part, axes, values in (("rotation", "wxyz", scan.rotation), ("translation", "xyz", scan.translation)):
        inner = libe57.StructureNode(image)
        pose.set(part, inner)
        for axis, value in zip(axes, values, strict=True):
            inner.set(axis, libe57.FloatNode(image, value))
    return pose


def _prototype(image: Any, libe57: Any, scan: Scan, name: str, column: NDArray[Any]) -> Any:
    """Return the type of a field: for integers within the bounds of the file's own field, or of the column's type."""
    if column.dtype.kind == "f":
        precision = libe57.E57_SINGLE if column.dtype.itemsize == 4 else libe57.E57_DOUBLE
        return libe57.FloatNode(image, 0.0, precision)
    known = next((field.bounds for field in scan.fields if field.name == name and field.dtype[0] in "iu"), None)
    least, most = int(column.min()), int(column.max())
    if known is None or not known[0] <= least <= most <= known[1]:
        bounds = np.iinfo(column.dtype)
        known = (int(bounds.min), int(bounds.max))
    return libe57.IntegerNode(image, known[0], *known)
