"""A cloud as the columns of a PLY and as the members of an NPZ, whichever of the two it came from."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..attributes import numeric_attributes, with_colours
from ..colours import BYTE
from ..errors import FormatError, shown
from ..flavours import NpzFlavour, PlyFlavour
from ..point_cloud import PointCloud
from ..roles import channels_of, ply_name
from .elements import SPELLINGS, TYPES

Column = tuple[str, str, NDArray[Any]]
"""Name, PLY type as spelled, (N,) values."""

POINT_MEMBERS = ("points", "xyz", "pos", "positions")
"""NPZ members that may hold the coordinates, the first one found counts."""

ROLE_MEMBERS = {*POINT_MEMBERS, "normals"}

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
    columns = _role(flavour.coordinates, cloud.points, declared)
    if cloud.normals is not None:
        columns |= _role(flavour.normals, cloud.normals, declared)
    attributes, notes = numeric_attributes(cloud, "PLY")
    if not isinstance(cloud.flavour, PlyFlavour | NpzFlavour):
        attributes, told = with_colours(attributes, BYTE, "PLY", cloud.brightest)
        notes += told
    for member, values in attributes.items():
        for found, column in _flat(member, values):
            part = found if found in declared else ply_name(found)
            taken = columns.keys() | (declared.keys() - {member})
            name = part if part in declared and part not in columns else _fresh_property(part, taken)
            spelled, column = _stored(name, column)
            columns[name] = (
                name,
                declared[name] if TYPES.get(declared.get(name, "")) == TYPES[spelled] else spelled,
                column,
            )
    order = list(declared) or [*flavour.coordinates]
    after = max(order.index(name) for name in flavour.coordinates) + 1
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
    channels = channels_of(member, table.shape[1])
    for index, column in enumerate(table.T):
        yield channels[index] if channels else f"{member}_{index}", column


def _stored(name: str, column: NDArray[Any]) -> tuple[str, NDArray[Any]]:
    """Return a PLY type that holds a column exactly, and the column in that type."""
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
    """Return a legal PLY property name that is not taken."""
    return fresh_name(re.sub(r"[^\x21-\x7e]", "_", name)[:56] or "_", taken)


def fresh_name(name: str, taken: Collection[str]) -> str:
    """Return `name`, or `name` with the first number from 2 on that makes it a name not yet taken."""
    candidates = (name if count == 1 else f"{name}_{count}" for count in range(1, len(taken) + 2))
    return next(candidate for candidate in candidates if candidate not in taken)
