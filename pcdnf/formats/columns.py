"""A cloud as the columns of a PLY and as the members of an NPZ, whichever of the two it came from."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .cloud import PointCloud
from .errors import FormatError, shown
from .flavours import NpzFlavour, PlyFlavour
from .ply_header import SPELLINGS, TYPES
from .values import numeric_attributes, with_eight_bit_colours

Column = tuple[str, str, NDArray[Any]]
"""Name, PLY type as spelled, (N,) values."""

POINT_MEMBERS = ("points", "xyz", "pos")
"""NPZ members that may hold the coordinates, the first one found counts."""

ROLE_MEMBERS = {*POINT_MEMBERS, "normals"}

_COLOUR_MEMBERS = {"rgb", "rgba", "color", "colors", "colour", "colours"}
_CHANNELS = ("red", "green", "blue", "alpha")
_EXACT_IN_FLOAT64 = 2**53


def ply_columns(cloud: PointCloud) -> tuple[list[Column], list[str]]:
    """Every per-point value as PLY properties, in the order and spelling of the file they came from.

    Normals the file did not have follow the coordinates. Attributes of several values a point become
    one property a value (``name_0``, ``name_1``, …; colours ``red``, ``green``, ``blue``).

    Returns
    -------
    columns : list of (name, type, values)
    notes : list of str
        What a PLY cannot carry.

    Raises
    ------
    FormatError
        ``cannot_store`` for integers beyond what PLY's types hold.
    """
    flavour = cloud.flavour if isinstance(cloud.flavour, PlyFlavour) else PlyFlavour()
    declared = dict(flavour.properties)
    columns = _role(("x", "y", "z"), cloud.points, declared)
    if cloud.normals is not None:
        columns |= _role(flavour.normals, cloud.normals, declared)
    attributes, notes = numeric_attributes(cloud, "PLY")
    if not isinstance(cloud.flavour, PlyFlavour | NpzFlavour):
        attributes = with_eight_bit_colours(attributes)
    for member, values in attributes.items():
        for part, column in _flat(member, values):
            taken = columns.keys() | (declared.keys() - {member})
            name = part if part in declared and part not in columns else _fresh_property(part, taken)
            spelled, column = _stored(name, column)
            columns[name] = (
                name,
                declared[name] if TYPES.get(declared.get(name, "")) == TYPES[spelled] else spelled,
                column,
            )
    order = list(declared) or ["x", "y", "z"]
    after = max(order.index(name) for name in "xyz") + 1
    order[after:after] = [name for name in flavour.normals if name not in declared]
    ordered = [name for name in order if name in columns] + [name for name in columns if name not in order]
    notes += [f"PLY holds per-point values only; {shown(name)} was left out." for name in cloud.extras]
    return [columns[name] for name in ordered], notes


def _role(names: tuple[str, str, str], values: NDArray[Any], declared: dict[str, str]) -> dict[str, Column]:
    """Coordinates or normals: in the file's own types while these are what ``values`` were read as."""
    spelled = [declared.get(name, "char") for name in names]
    kinds = [np.dtype(TYPES[one]) for one in spelled]
    if any(kind.kind != "f" for kind in kinds) or np.result_type(*kinds) != values.dtype:
        spelled = [SPELLINGS[values.dtype.str[1:]]] * 3
    return {name: (name, one, values[:, axis]) for axis, (name, one) in enumerate(zip(names, spelled, strict=True))}


def _flat(member: str, values: NDArray[Any]) -> Iterator[tuple[str, NDArray[Any]]]:
    """One name and column for each value a point has."""
    if values.ndim == 1:
        yield member, values
        return
    table = values.reshape(len(values), -1)
    is_colour = member.lower() in _COLOUR_MEMBERS and table.shape[1] in (3, 4)
    for index, column in enumerate(table.T):
        yield _CHANNELS[index] if is_colour else f"{member}_{index}", column


def _stored(name: str, column: NDArray[Any]) -> tuple[str, NDArray[Any]]:
    """A PLY type that holds a column exactly, and the column in it."""
    kind = column.dtype.str[1:]
    if kind in SPELLINGS:
        return SPELLINGS[kind], column
    if kind == "f2":
        return "float", column.astype(np.float32)
    if kind == "b1":
        return "uchar", column.astype(np.uint8)
    if kind in ("i8", "u8"):
        least, most = int(column.min()), int(column.max())
        for candidate in ("i4", "u4"):
            if np.iinfo(candidate).min <= least and most <= np.iinfo(candidate).max:
                return SPELLINGS[candidate], column.astype(candidate)
        if max(-least, most) <= _EXACT_IN_FLOAT64:
            return "double", column.astype(np.float64)
    raise FormatError(
        f"PLY has no type that holds the values of {shown(name)} ({column.dtype}).",
        code="cannot_store",
        hint="Write an NPZ instead.",
    )


def _fresh_property(name: str, taken: Collection[str]) -> str:
    """A legal PLY property name, not among those taken."""
    return _fresh(re.sub(r"[^\x21-\x7e]", "_", name)[:56] or "_", taken)


def _fresh(name: str, taken: Collection[str]) -> str:
    candidates = (name if count == 1 else f"{name}_{count}" for count in range(1, len(taken) + 2))
    return next(candidate for candidate in candidates if candidate not in taken)


def npz_members(cloud: PointCloud) -> tuple[dict[str, NDArray[Any]], list[str]]:
    """Everything a cloud carries as NPZ members, in the order and types of the file they came from.

    Metadata, comments and the like are text scalars named ``pcdnf_<key>``.

    Returns
    -------
    members : dict of str to array
    notes : list of str
        What an NPZ cannot carry: columns of words.
    """
    attributes, notes = numeric_attributes(cloud, "NPZ")
    flavour = cloud.flavour if isinstance(cloud.flavour, NpzFlavour) else None
    points_name = flavour.points if flavour else "points"
    points_dtype = np.dtype(flavour.points_dtype) if flavour else cloud.points.dtype
    if points_dtype.newbyteorder("=") != cloud.points.dtype:
        points_dtype = cloud.points.dtype
    members: dict[str, NDArray[Any]] = {points_name: cloud.points.astype(points_dtype, copy=False)}
    if cloud.normals is not None:
        stored = np.dtype(flavour.normals_dtype) if flavour and flavour.normals_dtype else points_dtype
        if stored.newbyteorder("=") != cloud.normals.dtype:
            stored = cloud.normals.dtype
        members["normals"] = cloud.normals.astype(stored, copy=False)
    reserved = set() if flavour else ROLE_MEMBERS
    for name, values in [*attributes.items(), *cloud.extras.items()]:
        legal = re.sub(r"[\x00-\x1f/\\]", "_", name)
        members[_fresh(legal, members.keys() | reserved)] = values
    order = flavour.members if flavour else ()
    ordered = {name: members[name] for name in order if name in members} | members
    texts = {f"pcdnf_{key}": value for key, value in cloud.metadata.items()}
    for key, lines in (("comments", cloud.comments), ("obj_info", cloud.obj_info)):
        if lines:
            texts[f"pcdnf_{key}"] = "\n".join(lines)
    return ordered | {name: np.array(_printable(text)) for name, text in texts.items()}, notes


def _printable(text: str) -> str:
    """Text that UTF-32 can hold: bytes of a header that were not UTF-8 become Latin-1 letters."""
    return "".join(chr(ord(letter) - 0xDC00) if 0xDC80 <= ord(letter) <= 0xDCFF else letter for letter in text)
