"""The elements of a PLY file and the types of their properties."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

BYTE_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"},
    **{"int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"},
}
"""Type names of the format, in both spellings, to numpy's."""

SPELLINGS = {dtype: name for name, dtype in reversed(TYPES.items())} | {"i1": "int8", "i2": "int16", "u2": "uint16"}
"""numpy's type names to the spelling that most readers know: the older one, but for the types that Open3D and meshio
know by their newer names only."""


@dataclass(frozen=True)
class Property:
    """One column: its name, its type as spelled, and the type of its length when it is a list."""

    name: str
    type: str
    length_type: str | None = None


@dataclass
class Element:
    """A table: its rows are of fixed size unless a property is a list."""

    name: str
    count: int
    properties: list[Property] = field(default_factory=list)

    @property
    def has_list(self) -> bool:
        """Whether a row's size depends on the row."""
        return any(prop.length_type for prop in self.properties)

    @property
    def least_stride(self) -> int:
        """Bytes of a binary row; for rows with lists, of one whose lists are empty."""
        return sum(np.dtype(TYPES[p.length_type or p.type]).itemsize for p in self.properties)

    @property
    def scalars(self) -> list[Property]:
        """The properties that are no lists."""
        return [prop for prop in self.properties if not prop.length_type]

    def row_dtype(self, byte_order: str) -> np.dtype[np.void]:
        """Return the type of a binary row, without its lists."""
        return np.dtype([(p.name, byte_order + TYPES[p.type]) for p in self.scalars])

    def lines(self) -> list[str]:
        """Return the element as lines of a header."""
        listed = [
            f"property list {p.length_type} {p.type} {p.name}" if p.length_type else f"property {p.type} {p.name}"
            for p in self.properties
        ]
        return [f"element {self.name} {self.count}", *listed]
