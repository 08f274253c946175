"""Columns on their way to another format: text that stands for numbers, and the names other formats use."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .colours import BYTE, WORD, colours_of, sixteen_bit_intensity
from .errors import shown
from .point_cloud import PointCloud
from .roles import CHANNELS, canonical_name, channels_of

Columns = dict[str, NDArray[Any]]

_NUMBER_LETTERS = np.zeros(256, bool)
_NUMBER_LETTERS[[*b"0123456789+-.eE \0"]] = True
_WIDEST_INTEGER = 18  # digits that int64 holds for certain


def numbers(column: NDArray[Any]) -> NDArray[Any] | None:
    """Return a column of text as int64 if all values are whole numbers, else as float64; None for other text.

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


def numeric_attributes(cloud: PointCloud, title: str) -> tuple[Columns, list[str]]:
    """Return the attributes as numbers, and a note for each column of words, which the format `title` cannot hold."""
    kept, notes = {}, []
    for name, column in cloud.attributes.items():
        values = numbers(column)
        if values is None:
            notes.append(f"{title} holds numbers only; the column {shown(name)} was left out.")
        else:
            kept[name] = values
    return kept, notes


def with_columns(cloud: PointCloud, columns: Columns) -> PointCloud:
    """Add columns, (N,) each, to a cloud; in its holes floats are NaN and integers 0.

    A column whose name is taken gets ``pcdnf_`` before it.
    """
    attributes, holes = dict(cloud.attributes), cloud.holes
    absent = {} if holes is None else dict(holes.attributes)
    for name, column in columns.items():
        taken = {known.lower() for known in attributes}
        while name in taken:
            name = f"pcdnf_{name}"
        attributes[name] = column
        if holes is not None:
            absent[name] = np.full(len(holes.rows), np.nan if column.dtype.kind == "f" else 0, column.dtype)
    return replace(cloud, attributes=attributes, holes=None if holes is None else replace(holes, attributes=absent))


def renamed(attributes: Columns) -> Columns:
    """Return the attributes under the names that formats with fixed fields use, if these names are free."""
    kept: Columns = {}
    for name, column in attributes.items():
        fixed = canonical_name(name)
        channels = channels_of(name, column.shape[1]) if column.ndim == 2 else ()
        if channels and not {*channels} & {*attributes}:
            kept |= dict(zip(channels, np.ascontiguousarray(column.T), strict=True))
        elif column.ndim == 2 and column.shape[1] == 1:
            kept[name if fixed in attributes or fixed in kept else fixed] = column[:, 0]
        else:
            kept[name if fixed in attributes or fixed in kept else fixed] = column
    return kept


def with_colours(
    attributes: Columns, top: int, title: str, brightest: float | None = None
) -> tuple[Columns, list[str]]:
    """Return the attributes with colours as red, green, blue from 0 to `top`, and a note if that loses something.

    Parameters
    ----------
    attributes : dict of str to (N, ...) array
    top : int
        255 for uint8, 65535 for uint16.
    title : str
        What the format is called.
    brightest : float, optional
        The stored value of full brightness, where the file says it.
    """
    colours = colours_of(attributes, brightest)
    if colours is None:
        return attributes, []
    table = colours.scaled(top).astype(np.uint8 if top == BYTE else np.uint16)
    channels = dict(zip(colours.names, zip(CHANNELS, table.T, strict=True), strict=True))
    kept: Columns = {}
    for name, column in attributes.items():
        to, values = channels.get(name, (name, column))
        kept[to] = np.ascontiguousarray(values)
    notes = []
    if not colours.is_exact(top):
        bits = 8 if top == BYTE else 16
        notes.append(
            f"{title} got colours of {bits} bits; those of the cloud, up to {colours.brightest:g}, were rounded."
        )
    return kept, notes


def with_intensity(attributes: Columns, title: str) -> tuple[Columns, list[str]]:
    """Return the attributes with an intensity of 16 bits, and a note if that loses something."""
    column = attributes.get("intensity")
    if column is None or column.dtype == np.uint16:
        return attributes, []
    values, how = sixteen_bit_intensity(column)
    if values is None:
        return attributes, [f"{title} has intensities from 0 to {WORD}; those of the cloud became a further column."]
    note = [f"{title} got intensities of 16 bits, {how}."] if how else []
    return attributes | {"intensity": values}, note
