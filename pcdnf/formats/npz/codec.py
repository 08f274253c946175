"""NPZ: arrays of real numbers by name, never through ``numpy.load``, never unpickled."""

from __future__ import annotations

import zipfile
import zlib
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError, shown
from ..flavours import NpzFlavour
from ..limits import FLOATS, Limits, check_count, check_enough
from ..ply.columns import POINT_MEMBERS
from ..point_cloud import PointCloud, checked
from ..roles import find_coordinates, find_normals
from .archive import NOTE_PREFIX, read_directory
from .inflate import Member, MemberStream
from .members import npz_members
from .npy import MAX_FIELDS, read_array, read_array_header, read_text, shape_text

NPY_MAGIC = b"\x93NUMPY"
_SAVED_AT = (1980, 1, 1, 0, 0, 0)
"""Same cloud, same bytes: no clock in the file."""
_LARGEST_PLAIN_MEMBER = 2**31 - 65536


def read_npz(file: BinaryIO, size: int, limits: Limits) -> PointCloud:
    """Read the members of an NPZ.

    ``points`` (else ``xyz``, ``pos``, or ``positions``) are the coordinates, ``normals`` the normals; other members
    whose first axis is as long are attributes, the rest are kept as extras.

    Parameters
    ----------
    file : seekable binary file
    size : int
        Bytes of the file.
    limits : Limits
        Bounds on points and bytes, and what to do with rows that are not finite.

    Raises
    ------
    FormatError
        With the code of what is wrong.
    """
    if file.read(len(NPY_MAGIC)) == NPY_MAGIC:
        return read_npy(file, size, limits)
    file.seek(0)
    members = {member.name: member for member in read_directory(file, size, limits)}
    if len(members) == 1 and members.keys().isdisjoint(POINT_MEMBERS):
        table = _table(file, next(iter(members.values())), limits)
        if table is not None:
            return table
    points_name = _points_name(members)
    warnings = [
        f"The coordinates are taken from {points_name}; {name} stays what it is."
        for name in POINT_MEMBERS
        if name in members and name != points_name
    ]
    stored = _points(file, members[points_name], limits)
    points = _floats(stored, "coordinates", np.dtype(np.float64), warnings)
    points_dtype, normals_dtype = _kept_dtype(stored, points), None
    normals = None
    if "normals" in members:
        stored = _normals(file, members["normals"], points.shape)
        normals = _floats(stored, "normals", points.dtype, warnings)
        normals_dtype = _kept_dtype(stored, normals)
    others = [member for name, member in members.items() if name not in (points_name, "normals")]
    arrays, texts = _others(file, others)
    per_point = [name for name, array in arrays.items() if array.ndim and len(array) == len(points)]
    cloud = PointCloud(
        points=points,
        normals=normals,
        attributes={name: arrays.pop(name) for name in per_point},
        extras=arrays,
        comments=texts.pop("comments", "").splitlines(),
        obj_info=texts.pop("obj_info", "").splitlines(),
        metadata=texts,
        flavour=NpzFlavour(
            members=tuple(name for name in members if name.removeprefix(NOTE_PREFIX) not in texts),
            points=points_name,
            points_dtype=points_dtype,
            normals_dtype=normals_dtype,
            compressed=members[points_name].deflated,
        ),
        warnings=warnings,
    )
    return checked(cloud, limits)


def read_npy(file: BinaryIO, size: int, limits: Limits) -> PointCloud:
    """Read a bare array: (N, 3) coordinates and further columns, or rows with fields named x, y, z.

    Raises
    ------
    FormatError
        With the code of what is wrong.
    """
    if size > limits.max_bytes:
        raise FormatError(
            f"The array has {size} bytes; the limit is {limits.max_bytes}.", code="file_too_large", hint="Thin it out."
        )
    file.seek(0)
    checksum = 0
    while piece := file.read(1 << 20):
        checksum = zlib.crc32(piece, checksum)
    member = Member("points", False, checksum, size, size, 0)
    table = _table(file, member, limits)
    if table is not None:
        return table
    stream = MemberStream(file, member)
    header = read_array_header(stream, member)
    if len(header.shape) != 2 or header.shape[1] < 3 or header.shape[1] > MAX_FIELDS:
        raise FormatError(
            f"The array has the shape {shape_text(header.shape)}; coordinates have (N, 3).",
            code="bad_shape",
            hint=_shape_hint(header.shape),
        )
    check_count(header.shape[0], limits)
    check_enough(header.shape[0], limits)
    warnings = ["The file holds a bare array; unless you name another format, the result is an NPZ."]
    values = _floats(read_array(stream, header), "coordinates", np.dtype(np.float64), warnings)
    if values.shape[1] > 3:
        warnings.append("The array names no columns; the first three were read as x, y, z.")
    others = {f"column_{number}": values[:, number - 1].copy() for number in range(4, values.shape[1] + 1)}
    cloud = PointCloud(
        points=np.ascontiguousarray(values[:, :3]), attributes=others, flavour=NpzFlavour(), warnings=warnings
    )
    return checked(cloud, limits)


def _table(file: BinaryIO, member: Member, limits: Limits) -> PointCloud | None:
    """Return the cloud of a structured array with fields x, y, z; None for other arrays."""
    stream = MemberStream(file, member)
    header = read_array_header(stream, member)
    names = header.dtype.names
    axes = find_coordinates(names or ())
    if names is None or axes is None or any(header.dtype[axis].shape for axis in axes):
        return None
    check_count(header.shape[0], limits)
    check_enough(header.shape[0], limits)
    rows = read_array(stream, header)
    columns = {name: np.ascontiguousarray(rows[name], rows[name].dtype.newbyteorder("=")) for name in names}
    warnings = ["The file holds one array with named fields; the result has an array a field."]
    points = _floats(
        np.stack([columns.pop(axis) for axis in axes], axis=1), "coordinates", np.dtype(np.float64), warnings
    )
    found = find_normals(name for name in columns if columns[name].ndim == 1 and columns[name].dtype.kind == "f")
    normals = None if found is None else np.stack([columns.pop(name) for name in found], axis=1)
    if normals is not None and normals.dtype not in FLOATS:
        normals = normals.astype(np.float32)
    cloud = PointCloud(points=points, normals=normals, attributes=columns, flavour=NpzFlavour(), warnings=warnings)
    return checked(cloud, limits)


def _points_name(members: dict[str, Member]) -> str:
    for name in POINT_MEMBERS:
        if name in members:
            return name
    seen = ", ".join(shown(name) for name in members) or "none"
    raise FormatError(
        f"The NPZ has no member named {', '.join(POINT_MEMBERS)}; its members are: {seen}.",
        code="missing_coordinates",
        hint="Save it with numpy.savez(path, points=…).",
    )


def _points(file: BinaryIO, member: Member, limits: Limits) -> NDArray[Any]:
    stream = MemberStream(file, member)
    header = read_array_header(stream, member)
    if len(header.shape) != 2 or header.shape[1] != 3:
        raise FormatError(
            f"Member {shown(member.name)} has the shape {shape_text(header.shape)}; coordinates have (N, 3).",
            code="bad_shape",
            hint=_shape_hint(header.shape),
        )
    check_count(header.shape[0], limits)
    check_enough(header.shape[0], limits)
    return read_array(stream, header)


def _shape_hint(shape: tuple[int, ...]) -> str:
    match shape:
        case (3, _):
            return "Save the transpose: points=a.T."
        case (_, 6):
            return "If the last three columns are normals, save points=a[:, :3], normals=a[:, 3:]."
        case (_, width) if width > 3:
            return "Save points=a[:, :3], and the other columns as members of their own."
        case (_, 2):
            return "Points need three coordinates."
        case (_,):
            return "If it holds x, y, z, x, y, z, …, save points=a.reshape(-1, 3)."
    return "Save one row of x, y, z a point."


def _normals(file: BinaryIO, member: Member, shape: tuple[int, ...]) -> NDArray[Any]:
    stream = MemberStream(file, member)
    header = read_array_header(stream, member)
    if header.shape != shape:
        raise FormatError(
            f"Member 'normals' has the shape {shape_text(header.shape)}; that of the points is {shape_text(shape)}.",
            code="bad_shape",
            hint="Save one normal a point, in the order of the points.",
        )
    return read_array(stream, header)


def _others(file: BinaryIO, members: list[Member]) -> tuple[dict[str, NDArray[Any]], dict[str, str]]:
    """Arrays by name, and our own texts by key."""
    arrays: dict[str, NDArray[Any]] = {}
    texts: dict[str, str] = {}
    for member in members:
        stream = MemberStream(file, member)
        header = read_array_header(stream, member, text=member.name.startswith(NOTE_PREFIX), truth=True)
        if header.is_text:
            texts[member.name.removeprefix(NOTE_PREFIX)] = read_text(stream, header)
        else:
            arrays[member.name] = read_array(stream, header)
    return arrays, texts


def _floats(array: NDArray[Any], what: str, if_integer: np.dtype[Any], warnings: list[str]) -> NDArray[Any]:
    """Coordinates or normals as native float32 or float64."""
    if array.dtype.kind == "f" and array.dtype.itemsize > 2:
        return np.ascontiguousarray(array, array.dtype.newbyteorder("="))
    is_half = array.dtype.kind == "f"
    dtype = np.dtype(np.float32) if is_half else if_integer
    kind = "half-precision numbers" if is_half else "integers"
    warnings.append(f"The {what} are stored as {kind}; the result stores them as {dtype}.")
    return np.ascontiguousarray(array, dtype)


def _kept_dtype(stored: NDArray[Any], used: NDArray[Any]) -> str:
    """Return the type of the file, including byte order, if results can have it."""
    return (stored if stored.dtype.newbyteorder("=") == used.dtype else used).dtype.str


def write_npz(file: BinaryIO, cloud: PointCloud) -> list[str]:
    """Write a cloud as it came, or deflated with ``points``, ``normals`` and attributes by name.

    Returns
    -------
    list of str
        What could not be carried over.
    """
    members, notes = npz_members(cloud)
    compressed = not isinstance(cloud.flavour, NpzFlavour) or cloud.flavour.compressed
    method = zipfile.ZIP_DEFLATED if compressed else zipfile.ZIP_STORED
    write_array: Any = np.lib.format.write_array  # has no types before numpy 2.4
    with zipfile.ZipFile(file, "w") as archive:
        for name, array in members.items():
            info = zipfile.ZipInfo(f"{name}.npy", _SAVED_AT)
            info.compress_type = method
            with archive.open(info, "w", force_zip64=array.nbytes > _LARGEST_PLAIN_MEMBER) as member:
                write_array(member, array, allow_pickle=False)
    return notes
