"""Text files of columns: XYZ, CSV and PTS; coordinates as float64, other columns as they are spelled."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..attributes import numbers
from ..comments import MAX_COMMENT_BYTES
from ..errors import FormatError
from ..flavours import TextFormat, XyzFlavour
from ..limits import Limits, check_count, check_enough
from ..point_cloud import PointCloud, checked
from ..roles import CHANNELS, NORMALS, find_colours, find_normals, free_normals
from .layout import MAX_ROW_BYTES, Layout, read_layout
from .rows import blocks

_UNNAMED_NORMALS = "If columns 4 to 6 are normals, name them: begin the file with a line `# x y z nx ny nz`."
_HEAD_BYTES = MAX_COMMENT_BYTES + 2 * MAX_ROW_BYTES
_FEWEST_COUNTED = 16

_IMPLIED = {
    (".xyzn", 6): (*"xyz", *NORMALS[0]),
    (".xyzrgb", 6): (*"xyz", *CHANNELS),
}
"""Columns that the ending of a name stands for, as Open3D has it."""


def read_xyz(file: BinaryIO, size: int, limits: Limits) -> PointCloud:
    """Read points from rows of text.

    Parameters
    ----------
    file : seekable binary file
        Open at its first byte.
    size : int
        Bytes of the file; the rows tell the number of points.
    limits : Limits
        Bounds on points, and what to do with rows that are not finite.

    Raises
    ------
    FormatError
        With the code of what is wrong.
    """
    layout = read_layout(file.read(_HEAD_BYTES))
    if not layout.names:
        layout.names = _IMPLIED.get((Path(str(file.name)).suffix.lower(), layout.width), ())
    if layout.count is not None:
        check_count(layout.count, limits)
        check_enough(layout.count, limits)
        least = layout.size + 2 * max(0, layout.count - 1) * layout.width - 1
        if least > size:
            _wrong_count(layout.count, f"a file of at least {least} bytes; the file has {size}", least, size)
    names = _attribute_names(layout)
    numeric = _numeric_columns(layout)
    parts: list[list[NDArray[Any]]] = [[] for _ in range(layout.width)]
    count = 0
    file.seek(layout.size)
    for block in blocks(file, layout):
        count += len(block)
        check_count(count, limits)
        for column, part in enumerate(parts):
            part.append(block.numbers(column) if column in numeric else block.text(column))
    warnings = _checked_count(layout, count)
    check_enough(count, limits)
    values = [np.concatenate(part) for part in parts]
    if not layout.names and layout.count is None and layout.width > 3 and _counts_rows(values[0]):
        names = ["number", *"xyz", *names[4:]]
        values[3] = _as_numbers(values[3])
        warnings.append("The first column counts the rows, so the coordinates were read from columns 2 to 4.")
    cloud = _cloud(layout, dict(zip(names, values, strict=True)))
    return checked(replace(cloud, warnings=[*cloud.warnings, *warnings]), limits)


def _counts_rows(column: NDArray[Any]) -> bool:
    """Return whether a column counts its rows from 0 or from 1."""
    if len(column) < _FEWEST_COUNTED or column[0] not in (0, 1):
        return False
    return bool((np.diff(column) == 1).all())


def _as_numbers(column: NDArray[Any]) -> NDArray[np.float64]:
    values = numbers(column)
    if values is None:
        raise FormatError(
            "The first column counts the rows, and column 4 holds words: there is no z.",
            code="missing_coordinates",
            hint="Name the columns: begin the file with a line `# x y z …`.",
        )
    return np.asarray(values, np.float64)


def _checked_count(layout: Layout, count: int) -> list[str]:
    """Compare the rows with what the file declares; a sentence where it is one off, or holds several scans."""
    if layout.count is None:
        return []
    declared = layout.count + sum(layout.counts)
    warnings = []
    if layout.counts:
        warnings.append(f"The file holds {len(layout.counts) + 1} scans; the result is one list of their points.")
    if abs(declared - count) == 1:
        warnings.append(f"The file declares {declared} points and has {count}; all of them were read.")
    elif declared != count:
        _wrong_count(declared, f"as many rows; there are {count}", declared, count)
    return warnings


def _wrong_count(declared: int, what: str, limit: int, actual: int) -> None:
    raise FormatError(
        f"The first line declares {declared} points and {what}.",
        code="truncated" if actual < limit else "trailing_data",
        hint="Correct the count, or copy the file again.",
        limit=limit,
        actual=actual,
    )


def _attribute_names(layout: Layout) -> list[str]:
    """One name a column: x, y, z first where the file names none."""
    if layout.names:
        return [name.lower() if name.lower() in "xyz" else name for name in layout.names]
    names = [*"xyz", *(f"column_{number}" for number in range(4, layout.width + 1))]
    if layout.count is not None and layout.width in (4, 7):
        names[3] = "intensity"
    return names


def _numeric_columns(layout: Layout) -> list[int]:
    lower = [name.lower() for name in layout.names] or [*"xyz"]
    normals = find_normals(lower) or ()
    return [lower.index(name) for name in (*"xyz", *normals)]


def _cloud(layout: Layout, columns: dict[str, NDArray[Any]]) -> PointCloud:
    """Columns into their roles."""
    points = np.stack([columns[axis] for axis in "xyz"], axis=1)
    found = find_normals(columns)
    spelled = found or ()
    normals = np.stack([columns[name] for name in spelled], axis=1) if found else None
    renamed = _colours(layout, columns)
    attributes = {renamed.get(name, name): column for name, column in columns.items() if name not in (*"xyz", *spelled)}
    named = [renamed.get(name, name) for name in columns]
    warnings = []
    if not layout.names and layout.width > 3:
        warnings.append(f"The file names no columns; they were read as {', '.join(named)}.")
        if layout.width == 6 and not renamed:
            warnings.append(_UNNAMED_NORMALS)
    return PointCloud(
        points=points,
        normals=normals,
        attributes=attributes,
        comments=layout.comments,
        metadata=layout.metadata,
        flavour=XyzFlavour(
            _format(layout),
            separator=layout.separator.decode(),
            columns=tuple(zip(named, layout.names or named, strict=True)),
            normals=found or free_normals(columns),
            header=layout.plain,
            comment=_comment_mark(layout),
            newline=layout.newline,
            counted=layout.count is not None,
            named=bool(layout.names),
        ),
        warnings=warnings,
    )


def _format(layout: Layout) -> TextFormat:
    if layout.count is not None:
        return "pts"
    return "csv" if layout.separator in b",;" else "xyz"


def _comment_mark(layout: Layout) -> str:
    """Return the prefix of comments in a result; empty if the file has none and a table has names or a count."""
    if layout.marks:
        return layout.marks[0]
    return "" if layout.plain or layout.count is not None else "#"


def _colours(layout: Layout, columns: dict[str, NDArray[Any]]) -> dict[str, str]:
    """Turn columns of colours into uint8 in place; their new names."""
    named: tuple[str, ...] = find_colours(columns) or ()
    if not layout.names:
        is_rgb, is_pts = layout.width == 6, layout.count is not None and layout.width > 6
        named = tuple(columns)[3:6] if is_rgb else tuple(columns)[4:7] if is_pts else ()
    values = [numbers(columns[name]) for name in named]
    fits = [one is not None and one.dtype.kind == "i" and one.min() >= 0 and one.max() <= 255 for one in values]
    if not values or not all(fits):
        return {}
    for name, one in zip(named, values, strict=True):
        assert one is not None
        columns[name] = one.astype(np.uint8)
    return dict(zip(named, CHANNELS, strict=True))
