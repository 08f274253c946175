"""A cloud as the fields of a PCD, whatever it came from; colours packed into one value and back."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..attributes import numeric_attributes, renamed, with_colours
from ..colours import BYTE
from ..errors import FormatError, shown
from ..flavours import PcdFlavour
from ..point_cloud import PointCloud
from ..roles import CHANNELS
from .coordinates import for_most_readers, split
from .header import MAX_FIELDS, MAX_VALUES, PADDING, Field

COLOUR_FIELDS = ("rgb", "rgba")
"""Fields of four bytes that hold blue, green, red and alpha, from the lowest byte up."""


def unpacked(values: NDArray[Any], *, alpha: bool) -> dict[str, NDArray[np.uint8]]:
    """Red, green and blue, and alpha where it is asked for or says anything, (N,) uint8 each."""
    octets = np.ascontiguousarray(values).view(np.uint8).reshape(-1, 4)
    colours = {"red": octets[:, 2].copy(), "green": octets[:, 1].copy(), "blue": octets[:, 0].copy()}
    return colours | {"alpha": octets[:, 3].copy()} if alpha or octets[:, 3].any() else colours


def packed(colours: NDArray[np.uint8], alpha: NDArray[Any] | None) -> NDArray[np.float32]:
    """Colours (N, 3) and alpha (N,) as the four bytes of a float a point, as PCL stores them."""
    octets = np.zeros((len(colours), 4), np.uint8)
    octets[:, :3] = colours[:, ::-1]
    if alpha is not None:
        octets[:, 3] = alpha
    return octets.view("<f4")[:, 0]


def pcd_columns(cloud: PointCloud, flavour: PcdFlavour) -> tuple[list[Field], list[NDArray[Any]], list[str]]:
    """Every per-point value as PCD fields, in the order and types of the file they came from.

    Returns
    -------
    fields : list of Field
    columns : list of (N, count) arrays
    notes : list of str
        What a PCD cannot carry.

    Raises
    ------
    FormatError
        ``cannot_store`` when there are more fields than a reader takes.
    """
    attributes, notes = numeric_attributes(cloud, "PCD")
    notes += [f"PCD holds per-point values only; {shown(name)} was left out." for name in cloud.extras]
    columns, told = _coordinates(cloud, flavour)
    notes += told
    if cloud.normals is not None:
        # PCL finds no normals of float64, whatever the coordinates are
        normals = cloud.normals if flavour.fields else cloud.normals.astype(np.float32)
        columns |= {name: normals[:, axis] for axis, name in enumerate(flavour.normals)}
    if flavour.packed or not flavour.fields:
        attributes, told = with_colours(
            renamed(attributes) if not flavour.fields else attributes, BYTE, "PCD", cloud.brightest
        )
        notes += told
        attributes = _with_packed(columns, attributes, flavour.packed)
    for name, column in attributes.items():
        columns[_fresh(name, columns)] = column
    return *_ordered(columns, flavour, len(cloud)), notes


def _coordinates(cloud: PointCloud, flavour: PcdFlavour) -> tuple[dict[str, NDArray[Any]], list[str]]:
    """Return the fields of the coordinates: as in the file, else as most programs read them."""
    names = flavour.coordinates
    if not isinstance(cloud.flavour, PcdFlavour) and cloud.points.dtype == np.float64:
        return for_most_readers(cloud.points, names)
    if (
        flavour.fields
        and cloud.points.dtype == np.float64
        and all(kind == "f4" for name, kind, _ in flavour.fields if name in names)
    ):
        return split(cloud.points, names), []  # its float32 is too coarse, or has remainders
    return {name: cloud.points[:, axis] for axis, name in enumerate(names)}, []


def _with_packed(
    columns: dict[str, NDArray[Any]], attributes: dict[str, NDArray[Any]], name: str
) -> dict[str, NDArray[Any]]:
    """Add the colours among the attributes to the columns, as one value; the attributes that are left."""
    channels = [attributes.get(channel) for channel in CHANNELS]
    if any(channel is None or channel.dtype != np.uint8 for channel in channels):
        return attributes
    alpha = attributes.get("alpha")
    alpha = alpha if alpha is not None and alpha.dtype == np.uint8 and alpha.ndim == 1 else None
    columns[name or ("rgb" if alpha is None else "rgba")] = packed(np.stack(channels, axis=1), alpha)  # type: ignore[arg-type]
    taken = {*CHANNELS, *(() if alpha is None else ("alpha",))}
    return {key: column for key, column in attributes.items() if key not in taken}


def _ordered(
    columns: dict[str, NDArray[Any]], flavour: PcdFlavour, count: int
) -> tuple[list[Field], list[NDArray[Any]]]:
    fields: list[Field] = []
    arrays: list[NDArray[Any]] = []
    declared = [Field(*field) for field in flavour.fields]
    for field in declared:
        if field.name == PADDING:
            fields.append(field)
            arrays.append(np.zeros((count, field.count), field.dtype))
        elif field.name in columns:
            stored = _table(columns.pop(field.name))
            if field.name == flavour.packed:
                stored = stored.view("<" + field.dtype)
            known = stored.dtype.str[1:] == field.dtype and stored.shape[1] == field.count
            fields.append(field if known else Field(field.name, stored.dtype.str[1:], stored.shape[1]))
            arrays.append(stored)
    for name, column in columns.items():
        stored = _table(column)
        fields.append(Field(name, stored.dtype.str[1:], stored.shape[1]))
        arrays.append(stored)
    values = sum(field.count for field in fields)
    if len(fields) > MAX_FIELDS or values > MAX_VALUES:
        raise FormatError(
            f"The cloud has {len(fields)} fields of {values} values a point; a PCD may have {MAX_FIELDS} "
            f"of {MAX_VALUES}.",
            code="cannot_store",
            hint="Write an NPZ instead.",
        )
    return fields, arrays


def _table(column: NDArray[Any]) -> NDArray[Any]:
    """Return a column as (N, count), little-endian, in a type that PCD has."""
    width = int(np.prod(column.shape[1:]))
    kind = {"f2": "f4", "b1": "u1"}.get(column.dtype.str[1:], column.dtype.str[1:])
    return np.ascontiguousarray(column.reshape(len(column), width), "<" + kind)


def _fresh(name: str, taken: dict[str, NDArray[Any]]) -> str:
    """Return a legal field name that is not taken."""
    stem = re.sub(r"[^\x21-\x7e]", "_", name)[:56]
    stem = stem if stem not in ("", PADDING) else "field"
    names = (stem if count == 1 else f"{stem}_{count}" for count in range(1, len(taken) + 2))
    return next(one for one in names if one not in taken)
