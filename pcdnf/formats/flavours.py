"""The storage details of a file, one small class for each format, so that a result can have the same."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from .e57.facts import Fact
from .e57.header import Scan
from .las.grid import Grid
from .las.header import Record
from .las.points import Extra


@dataclass(frozen=True)
class Block:
    """An element of a PLY beside its vertices: its name, its lines of the header, and its rows as they stand."""

    name: str
    lines: tuple[str, ...]
    body: bytes


@dataclass(frozen=True)
class PlyFlavour:
    """How a PLY stored its vertices.

    Attributes
    ----------
    encoding : str
    properties : tuple of (name, type as spelled)
        In file order, without lists.
    normals, coordinates : tuple of str
        The names of the three components.
    before, after : tuple of Block
        The other elements, such as faces; they come back where no vertex was left out.
    """

    encoding: str = "binary_little_endian"
    properties: tuple[tuple[str, str], ...] = ()
    normals: tuple[str, str, str] = ("nx", "ny", "nz")
    before: tuple[Block, ...] = ()
    after: tuple[Block, ...] = ()
    coordinates: tuple[str, str, str] = ("x", "y", "z")
    format: Literal["ply"] = "ply"


@dataclass(frozen=True)
class NpzFlavour:
    """How an NPZ stored its arrays: member names in order, types of the two known ones."""

    members: tuple[str, ...] = ("points",)
    points: str = "points"
    points_dtype: str = "<f4"
    normals_dtype: str | None = None
    compressed: bool = True
    format: Literal["npz"] = "npz"


@dataclass(frozen=True)
class PcdFlavour:
    """How a PCD stored its points.

    Attributes
    ----------
    encoding : {"ascii", "binary", "binary_compressed"}
    fields : tuple of (name, numpy type, count)
        In file order; a field named ``_`` is padding.
    width, height : int
        The grid of an organised cloud; it is kept while no point is left out.
    viewpoint : str
        As spelled.
    packed : str
        The field that holds colours packed into one value, ``""`` for none.
    normals : tuple of str
        The names of the three components.
    coordinates : tuple of str
        Their names.
    """

    encoding: str = "binary"
    fields: tuple[tuple[str, str, int], ...] = ()
    width: int = 0
    height: int = 1
    viewpoint: str = "0 0 0 1 0 0 0"
    packed: str = ""
    normals: tuple[str, str, str] = ("normal_x", "normal_y", "normal_z")
    coordinates: tuple[str, str, str] = ("x", "y", "z")
    format: Literal["pcd"] = "pcd"

    def with_doubles(self) -> PcdFlavour:
        """Return the flavour with coordinates of float64."""
        fields = ((name, "f8" if name in self.coordinates else kind, count) for name, kind, count in self.fields)
        return replace(self, fields=tuple(fields))


TextFormat = Literal["xyz", "csv", "pts"]


@dataclass(frozen=True)
class XyzFlavour:
    """How a text file stored its columns.

    Attributes
    ----------
    format : {"xyz", "csv", "pts"}
        Separated by white space, by a comma or semicolon, or with the number of points in the first line.
    separator : str
    columns : tuple of (name, name as spelled)
        In file order.
    normals : tuple of str
        The names of the three components.
    header : bool
        Whether the names stand in a line of their own.
    comment : str
        What begins a comment line; empty where none may be written.
    newline : str
    counted : bool
        Whether the first line is the number of points.
    named : bool
        Whether the file named its columns, so that readers do not go by their places.
    """

    format: TextFormat = "xyz"
    separator: str = " "
    columns: tuple[tuple[str, str], ...] = ()
    normals: tuple[str, str, str] = ("nx", "ny", "nz")
    header: bool = False
    comment: str = "#"
    newline: str = "\n"
    counted: bool = False
    named: bool = False


@dataclass(frozen=True)
class LasFlavour:
    """How a LAS or LAZ stored its points.

    Attributes
    ----------
    format : {"las", "laz"}
    header : bytes
        The public header.
    records : tuple of Record
        Variable-length records, coordinate systems among them; not those on compression and extra dimensions.
    gap : bytes
        What stood between the records and the points.
    tail : bytes
        What followed the points: extended records.
    tail_start : int
        Where it began.
    point_format : int
    extras : tuple of Extra
        The extra dimensions, in file order.
    grid : Grid
    normals : tuple of str
        The names of the three components.
    """

    format: Literal["las", "laz"] = "las"
    header: bytes = b""
    records: tuple[Record, ...] = ()
    gap: bytes = b""
    tail: bytes = b""
    tail_start: int = 0
    point_format: int = 6
    extras: tuple[Extra, ...] = ()
    grid: Grid = field(default_factory=Grid)
    normals: tuple[str, str, str] = ("NormalX", "NormalY", "NormalZ")


_STANDING = (*("0 0 0", "1 0 0", "0 1 0", "0 0 1"), *("1 0 0 0", "0 1 0 0", "0 0 1 0", "0 0 0 1"))


@dataclass(frozen=True)
class PtxScan:
    """One scan of a PTX: its grid, and its position, axes and matrix as spelled."""

    columns: int
    rows: int
    lines: tuple[str, ...] = _STANDING

    def matrix(self) -> NDArray[np.float64]:
        """(4, 3) float64: rows of a point times the first three, plus the last, are in the common frame."""
        return np.array([[float(word) for word in line.split()[:3]] for line in self.lines[4:]])


@dataclass(frozen=True)
class PtxFlavour:
    """The scans of a PTX in file order."""

    scans: tuple[PtxScan, ...] = ()
    format: Literal["ptx"] = "ptx"


@dataclass(frozen=True)
class E57Flavour:
    """How an E57 stored its points.

    Attributes
    ----------
    scans : tuple of Scan
        Those that have points, in file order.
    coordinate_system : str
        As the file spells it, WKT for instance.
    brightest : float or None
        The highest limit of colours, where the file has one.
    facts : tuple of Fact
        What else the file says of itself, such as when it was made.
    """

    scans: tuple[Scan, ...] = ()
    coordinate_system: str = ""
    brightest: float | None = None
    facts: tuple[Fact, ...] = ()
    format: Literal["e57"] = "e57"
