"""Clouds as columns of text: the layout they came in, or that of the format that was asked for."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import chain, count
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..attributes import renamed
from ..colours import BYTE, colours_of
from ..comments import note_lines
from ..errors import FormatError, shown
from ..flavours import TextFormat, XyzFlavour
from ..point_cloud import PointCloud
from ..roles import CHANNELS
from .layout import MAX_COLUMNS

_ROWS_PER_WRITE = 1 << 16
_BLANKS = (b" ", b"\t", b"\v", b"\f")

_DEFAULTS = {
    "xyz": XyzFlavour("xyz"),
    "csv": XyzFlavour("csv", separator=",", header=True, comment=""),
    "pts": XyzFlavour("pts", counted=True, comment=""),
}
"""How clouds of other formats are written."""


def write_xyz(file: BinaryIO, cloud: PointCloud, format_: TextFormat | None = None) -> list[str]:
    """Write a cloud as it came, or in the layout of ``format_`` when it came as something else.

    Returns
    -------
    list of str
        What could not be carried over.

    Raises
    ------
    FormatError
        ``cannot_store``.
    """
    flavour = cloud.flavour if isinstance(cloud.flavour, XyzFlavour) else None
    if flavour is None or format_ not in (None, flavour.format):
        own = flavour.normals if flavour else ("nx", "ny", "nz")
        flavour = replace(_DEFAULTS[format_ or "xyz"], normals=own)
    columns, notes = _columns(cloud, flavour)
    if len(columns) > MAX_COLUMNS:
        raise FormatError(
            f"The cloud has {len(columns)} values a point; a text file may have {MAX_COLUMNS} columns.",
            code="cannot_store",
            hint="Write an NPZ instead.",
            limit=MAX_COLUMNS,
            actual=len(columns),
        )
    spelled = dict(flavour.columns)
    names = flavour.separator.join(spelled.get(name, name) for name in columns)
    lines = [str(len(cloud))] if flavour.counted else []
    recorded = [f"pcdnf {key}: {value}" for key, value in cloud.metadata.items()]
    if flavour.comment:
        texts = [*cloud.comments, *cloud.obj_info, *recorded, *([] if flavour.header else [names])]
        lines += note_lines(flavour.comment, texts)
    elif cloud.comments or cloud.obj_info or recorded:
        notes.append(
            f"This {flavour.format.upper()} has no place for comments, so the metadata of the run was left out."
        )
    lines += [names] if flavour.header else []
    file.write("".join(line + flavour.newline for line in lines).encode("utf-8", "surrogateescape"))
    _write_rows(file, list(columns.values()), flavour)
    return notes


def _columns(cloud: PointCloud, flavour: XyzFlavour) -> tuple[dict[str, NDArray[Any]], list[str]]:
    """One column a value, in the order of the file they came from; new ones follow."""
    notes = [f"A text file holds per-point values only; {shown(name)} was left out." for name in cloud.extras]
    columns = {axis: cloud.points[:, index] for index, axis in enumerate("xyz")}
    colours = colours_of(cloud.attributes, cloud.brightest)
    channels = dict(zip(colours.names, CHANNELS, strict=True)) if colours and colours.is_exact(BYTE) else {}
    if colours and channels:
        columns |= dict(zip(CHANNELS, colours.scaled(BYTE).T, strict=True))
    if cloud.normals is not None and flavour.counted and not flavour.named:
        notes.append("PTS has no place for normals, so they were left out. PLY, LAZ and E57 have one.")
    elif cloud.normals is not None:
        columns |= {name: _shortest(cloud.normals[:, axis]) for axis, name in enumerate(flavour.normals)}
    named = cloud.attributes if isinstance(cloud.flavour, XyzFlavour) else renamed(cloud.attributes)
    declared = dict(flavour.columns)
    for name, values in named.items():
        if name in channels:
            continue
        if values.dtype.kind == "S" and not _fits(values, flavour.separator):
            notes.append(
                f"The column {shown(name)} has words with the separator of this file in them; it was left out."
            )
            continue
        table = values.reshape(len(values), -1) if values.ndim > 1 else values[:, None]
        known = name if name in declared else _word(name, flavour)
        for index, column in enumerate(table.T):
            part = known if table.shape[1] == 1 else f"{known}_{index}"
            columns[part if part in declared else _free(part, columns)] = column
    order = [name for name, _ in flavour.columns if name in columns]
    if flavour.counted and not flavour.columns:
        order = [name for name in (*"xyz", "intensity", *CHANNELS) if name in columns]
        lost = [shown(name) for name in columns if name not in order]
        notes += [f"PTS holds intensity and colours only; left out were: {', '.join(lost)}."] if lost else []
        return {name: columns[name] for name in order}, notes
    return {name: columns[name] for name in [*order, *(name for name in columns if name not in order)]}, notes


def _word(name: str, flavour: XyzFlavour) -> str:
    """Return a name without the characters that separate names."""
    return "_".join(name.replace(flavour.separator, " ").split()) or "column"


def _free(name: str, taken: Iterable[str]) -> str:
    """Return the name, or the name with a number, that no other column has in upper or lower case."""
    lower = {one.lower() for one in taken}
    return next(one for one in chain([name], (f"{name}_{n}" for n in count(2))) if one.lower() not in lower)


def _shortest(column: NDArray[Any]) -> NDArray[Any]:
    """Return a column as float32 if that loses nothing, for fewer digits."""
    single = column.astype(np.float32)
    return single if np.array_equal(single, column) else column


def _fits(column: NDArray[Any], separator: str) -> bool:
    """Whether words stay one value each beside this separator."""
    if separator not in " \t":
        return not bool((np.char.find(column, separator.encode()) >= 0).any())
    blank = any(bool((np.char.find(column, mark) >= 0).any()) for mark in _BLANKS)
    return not blank and bool((np.char.str_len(column) > 0).all())


def _write_rows(file: BinaryIO, columns: list[NDArray[Any]], flavour: XyzFlavour) -> None:
    """Rows with the digits that bring each value back exactly."""
    formats = {"f4": b"%.9g", "f2": b"%.9g", "f8": b"%r"}
    cells = [b"%s" if column.dtype.kind == "S" else formats.get(column.dtype.str[1:], b"%d") for column in columns]
    line = flavour.separator.encode().join(cells) + flavour.newline.encode()
    for start in range(0, len(columns[0]), _ROWS_PER_WRITE):
        parts = [column[start : start + _ROWS_PER_WRITE].tolist() for column in columns]
        file.write(line * len(parts[0]) % tuple(chain.from_iterable(zip(*parts, strict=True))))
