"""Columns on their way to another format: text that stands for numbers, colours of 16 bits that are of 8."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import shown
from .point_cloud import PointCloud

CHANNELS = ("red", "green", "blue")

_NUMBER_LETTERS = np.zeros(256, bool)
_NUMBER_LETTERS[[*b"0123456789+-.eE \0"]] = True
_WIDEST_INTEGER = 18  # digits that int64 holds for certain


def numbers(column: NDArray[Any]) -> NDArray[Any] | None:
    """A column of text as int64 where all of it are whole numbers, else as float64; None for other text.

    Columns that are not text come back as they are.
    """
    if column.dtype.kind != "S":
        return column
    letters = np.frombuffer(np.ascontiguousarray(column).tobytes(), np.uint8)
    plain = bool(_NUMBER_LETTERS[letters].all())
    if plain and column.dtype.itemsize <= _WIDEST_INTEGER and not np.isin(letters, [*b".eE"]).any():
        try:
            return column.astype(np.int64)
        except ValueError:
            return None
    try:
        values: NDArray[Any] = column.astype(np.float64)
    except ValueError:
        return None
    return None if np.isin(letters, ord("_")).any() else values


def numeric_attributes(cloud: PointCloud, title: str) -> tuple[dict[str, NDArray[Any]], list[str]]:
    """The attributes as numbers, and a note for each column of words, which the format called ``title`` cannot hold."""
    kept, notes = {}, []
    for name, column in cloud.attributes.items():
        values = numbers(column)
        if values is None:
            notes.append(f"{title} holds numbers only; the column {shown(name)} was left out.")
        else:
            kept[name] = values
    return kept, notes


def eight_bit_colours(attributes: dict[str, NDArray[Any]]) -> NDArray[np.uint8] | None:
    """Red, green, blue as (N, 3) uint8, where the attributes of these names lose nothing by it; else None.

    Colours of 16 bits are often those of 8, times 257 or 256.
    """
    columns = [attributes.get(name) for name in CHANNELS]
    found = [column for column in columns if column is not None and column.ndim == 1 and column.dtype.kind in "iu"]
    if len(found) < len(CHANNELS):
        return None
    table = np.stack(found, axis=1)
    if table.size == 0 or table.min() < 0 or table.max() > np.iinfo(np.uint16).max:
        return table.astype(np.uint8) if table.size == 0 else None
    if table.dtype.itemsize == 1 or table.max() <= np.iinfo(np.uint8).max:
        return table.astype(np.uint8)
    factor = next((factor for factor in (257, 256) if not (table % factor).any()), None)
    return None if factor is None else (table // factor).astype(np.uint8)


def with_eight_bit_colours(attributes: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """The attributes, colours as uint8 where they lose nothing by it."""
    table = eight_bit_colours(attributes)
    if table is None:
        return attributes
    colours = dict(zip(CHANNELS, table.T, strict=True))
    return {name: colours.get(name, column) for name, column in attributes.items()}
