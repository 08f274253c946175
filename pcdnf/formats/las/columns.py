"""A cloud as the dimensions of a LAS, whatever it came from."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..attributes import renamed, with_colours, with_intensity
from ..colours import WORD
from ..errors import shown
from ..flavours import LasFlavour
from ..point_cloud import PointCloud
from ..roles import CHANNELS
from .copc import FORMATS
from .grid import Grid
from .points import RECORDS, Extra, bits_of, new_extra, pack, record_dtype

_DEGREES = 0.006
_INTEGERS = {name for name, kind, *_ in RECORDS[8][3:] if "f" not in kind}
_INTEGERS |= {part for form in (0, 6) for parts in bits_of(form).values() for part, _ in parts} | {"scan_angle_rank"}


def new_flavour(attributes: dict[str, NDArray[Any]], compressed: bool, known: LasFlavour | None = None) -> LasFlavour:
    """LAS 1.4 with the point format that holds the colours there are.

    Parameters
    ----------
    attributes : dict of str to (N, ...) array
    compressed : bool
    known : LasFlavour, optional
        One of an older point format, whose identifiers and records are kept.
    """
    has_colour = all(name in attributes for name in CHANNELS)
    header = bytearray(375)
    header[:4] = b"LASF"
    struct.pack_into("<HBB", header, 6, 0x10, 0, 0)
    header[26:31] = b"pcdnf"
    header[58:63] = b"pcdnf"
    if known is not None:
        header[4:94] = known.header[4:94]
    header[24:26] = b"\x01\x04"
    struct.pack_into("<HH", header, 94, 375, 0)
    point_format = (8 if "nir" in attributes else 7) if has_colour else 6
    return LasFlavour(
        format="laz" if compressed else "las",
        header=bytes(header),
        records=known.records if known else (),
        point_format=point_format,
        extras=_extras(known, attributes, point_format) if known else (),
        grid=known.grid if known else Grid(),
        normals=known.normals if known else ("NormalX", "NormalY", "NormalZ"),
    )


def _extras(known: LasFlavour, attributes: dict[str, NDArray[Any]], point_format: int) -> tuple[Extra, ...]:
    """Extra dimensions of an older point format that the newer one takes as they are, with scale and description."""
    taken = {field[0] for field in RECORDS[point_format]}

    def is_same(extra: Extra) -> bool:
        column = attributes.get(extra.name)
        if column is None or extra.name in taken:
            return False
        return column.dtype == np.dtype(extra.dtype) and column.size == extra.count * len(column)

    return tuple(extra for extra in known.extras if is_same(extra))


def fits_copc(flavour: LasFlavour) -> bool:
    """Whether points of this flavour may be in a COPC."""
    return flavour.point_format in FORMATS and flavour.header[25] == 4


def las_attributes(
    attributes: dict[str, NDArray[Any]], brightest: float | None = None
) -> tuple[dict[str, NDArray[Any]], list[str]]:
    """Columns of another format under the names, and in the ranges, of LAS; and notes on what that loses.

    Colours and intensity are spread over 16 bits; whole numbers that are stored as floats become integers.
    """
    named = renamed(attributes)
    if "scan_angle_rank" in named and "scan_angle" not in named:  # whole degrees, which LAS 1.4 counts by 0.006
        named["scan_angle"] = np.rint(named.pop("scan_angle_rank").astype(np.float64) / _DEGREES).astype(np.int64)
    columns, notes = with_colours(named, WORD, "LAS", brightest)
    columns, told = with_intensity(columns, "LAS")
    return {name: _whole(name, column) for name, column in columns.items()}, notes + told


def _whole(name: str, column: NDArray[Any]) -> NDArray[Any]:
    """Return a column as one of the integers of LAS, if all its values are whole."""
    if name not in _INTEGERS or column.dtype.kind != "f" or not np.isfinite(column).all():
        return column
    whole = np.rint(column).astype(np.int64)
    return whole if np.array_equal(whole, column) else column


def las_columns(
    cloud: PointCloud, attributes: dict[str, NDArray[Any]], flavour: LasFlavour
) -> tuple[dict[str, NDArray[Any]], tuple[Extra, ...], list[str]]:
    """Columns by the names of dimensions, the extra dimensions, those the file had first, and notes on their names."""
    extras = list(flavour.extras)
    known = {extra.name: extra for extra in extras}
    probe = np.zeros(len(cloud), record_dtype(flavour.point_format, ()))
    standard = {name: column for name, column in attributes.items() if name not in known}
    homeless = pack(probe, standard, flavour.point_format, ())
    columns = {name: column for name, column in attributes.items() if name not in homeless}
    if cloud.normals is not None:
        homeless |= {name: cloud.normals[:, axis] for axis, name in enumerate(flavour.normals) if name not in known}
        columns |= {name: cloud.normals[:, axis] for axis, name in enumerate(flavour.normals) if name in known}
    taken = {*known, "X", "Y", "Z", *(field[0] for field in RECORDS[flavour.point_format])}
    taken |= {part for parts in bits_of(flavour.point_format).values() for part, _ in parts}
    strange = [shown(name) for name in homeless if name in taken and name != "intensity"]
    notes = [f"LAS has another range of {', '.join(strange)}; those of the cloud became further columns."]
    for name, column in homeless.items():
        table = column.reshape(len(column), -1) if column.ndim > 1 else column[:, None]
        for index, part in enumerate(table.T):
            kind = np.dtype({"f2": "f4", "b1": "u1"}.get(part.dtype.str[1:], part.dtype.str[1:]))
            stem = (name if table.shape[1] == 1 else f"{name}_{index}").encode()[:26].decode("utf-8", "ignore")
            fresh = next(
                one for count in range(len(taken) + 1) if (one := f"{stem}_{count}" if count else stem) not in taken
            )
            taken.add(fresh)
            extras.append(new_extra(fresh, kind))
            columns[fresh] = part
    return columns, tuple(extras), notes if strange else []
