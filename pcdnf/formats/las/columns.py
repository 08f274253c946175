"""A cloud as the dimensions of a LAS, whatever it came from."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..attributes import CHANNELS, eight_bit_colours
from ..flavours import LasFlavour
from ..point_cloud import PointCloud
from .points import RECORDS, Extra, bits_of, new_extra, pack, record_dtype


def new_flavour(attributes: dict[str, NDArray[Any]], compressed: bool) -> LasFlavour:
    """LAS 1.4 with the point format that holds the colours there are."""
    has_colour = all(name in attributes for name in CHANNELS)
    header = bytearray(375)
    header[:4] = b"LASF"
    struct.pack_into("<HBB", header, 6, 0x10, 0, 0)
    header[24:26] = b"\x01\x04"
    header[26:31] = b"pcdnf"
    header[58:63] = b"pcdnf"
    struct.pack_into("<HH", header, 94, 375, 0)
    return LasFlavour(format="laz" if compressed else "las", header=bytes(header), point_format=7 if has_colour else 6)


def sixteen_bit_colours(attributes: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Colours of 8 bits spread over 16, as LAS asks for."""
    table = eight_bit_colours(attributes)
    if table is None:
        return attributes
    return attributes | {name: table[:, index].astype(np.uint16) * 257 for index, name in enumerate(CHANNELS)}


def las_columns(
    cloud: PointCloud, attributes: dict[str, NDArray[Any]], flavour: LasFlavour
) -> tuple[dict[str, NDArray[Any]], tuple[Extra, ...]]:
    """Columns by the names of dimensions, and the extra dimensions, those the file had first."""
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
    return columns, tuple(extras)
