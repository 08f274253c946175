"""A LAS or LAZ put together: header, records, points, and what follows them."""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError
from ..flavours import LasFlavour
from .copc import Octree, hierarchy_record, info_record, without_copc
from .grid import Grid
from .header import COMPRESSED, EVLR, VLR, Record
from .laz import Compressor
from .points import EXTRA_ENTRY, Extra

LARGEST_RECORD = 2**16 - 1
_NEWEST = 4
_COPC_HEADER = 375
WKT = 0x10
"""Bit of the global encoding: a coordinate system is written as WKT."""
_ROWS_PER_WRITE = 1 << 18


@dataclass(frozen=True)
class Assembly:
    """What goes into a file.

    Attributes
    ----------
    flavour : LasFlavour
    grid : Grid
    extras : tuple of Extra
    rows : (N,) structured array
        The point records.
    records : list of Record
        Without those on extra dimensions and compression.
    """

    flavour: LasFlavour
    grid: Grid
    extras: tuple[Extra, ...]
    rows: NDArray[np.void]
    records: list[Record]

    def write_las(self, file: BinaryIO) -> None:
        """Write the points as they are."""
        header = self._begin(file, self.records, compressed=False)
        for at in range(0, len(self.rows), _ROWS_PER_WRITE):
            file.write(self.rows[at : at + _ROWS_PER_WRITE].tobytes())
        self._end(file, header, self.flavour.tail)

    def write_laz(self, file: BinaryIO) -> None:
        """Write the points compressed."""
        compressor = self._compressor(variable=False)
        header = self._begin(file, [*self.records, _laszip(compressor)], compressed=True)
        compressor.write(file, self.rows)
        self._end(file, header, self.flavour.tail)

    def write_copc(self, file: BinaryIO, tree: Octree) -> None:
        """Write the points compressed, a chunk a node, and the index of the nodes."""
        raw = self.flavour.header[:_COPC_HEADER]
        records, tail, _ = without_copc(tuple(self.records), self.flavour.tail)
        header = bytearray(raw)
        struct.pack_into("<H", header, 94, len(raw))
        struct.pack_into("<H", header, 6, struct.unpack_from("<H", raw, 6)[0] | WKT)  # as COPC requires
        flavour = replace(self.flavour, header=bytes(header), gap=b"")
        whole = replace(self, flavour=flavour, records=list(records))
        times = np.asarray(self.rows["gps_time"], np.float64)
        compressor = self._compressor(variable=True)
        others = [*whole.records, _laszip(compressor)]
        header = whole._begin(file, [info_record(tree, times, 0), *others], compressed=True)
        places = compressor.write_chunks(file, self.rows, tree.counts)
        file.seek(0, 2)
        page = hierarchy_record(tree, places)
        at = file.tell() + len(tail) + EVLR.size
        header = whole._records_into(header, [info_record(tree, times, at), *others])
        struct.pack_into("<I", header, 243, _count(tail) + 1)
        whole._end(file, header, tail + page)

    def _compressor(self, *, variable: bool) -> Compressor:
        return Compressor(self.flavour.point_format, sum(extra.size for extra in self.extras), variable=variable)

    def _begin(self, file: BinaryIO, records: list[Record], *, compressed: bool) -> bytearray:
        """Write header and records up to the first point; the header."""
        header = self._records_into(bytearray(self.flavour.header), records)
        kind = self.flavour.point_format | (COMPRESSED if compressed else 0)
        struct.pack_into("<BH", header, 104, kind, self.rows.dtype.itemsize)
        file.write(header + self.flavour.gap)
        return header

    def _records_into(self, header: bytearray, records: list[Record]) -> bytearray:
        """Return the header followed by all records, with their number and the start of the points filled in."""
        listed = b"".join(extra.entry or _undocumented(extra) for extra in self.extras)
        records = [*records, Record(b"LASF_Spec", 4, b"", listed)] if self.extras else records
        too_long = next((record for record in records if len(record.data) > LARGEST_RECORD), None)
        if too_long is not None:
            raise FormatError(
                f"The cloud needs {len(too_long.data)} bytes in a record of the header; LAS holds {LARGEST_RECORD}.",
                code="cannot_store",
                hint="Remove comments or columns, or write an NPZ.",
            )
        packed = b"".join(
            VLR.pack(b"", one.user, one.number, len(one.data), one.description) + one.data for one in records
        )
        filled = header[: len(self.flavour.header)] + packed
        struct.pack_into("<II", filled, 96, len(filled) + len(self.flavour.gap), len(records))
        return filled

    def _end(self, file: BinaryIO, header: bytearray, tail: bytes) -> None:
        """Write what follows the points, then the header once more: with counts and bounds."""
        file.seek(0, 2)
        end = file.tell()
        file.write(tail)
        self._fill(header, end, tail)
        file.seek(0)
        file.write(header)
        file.seek(0, 2)

    def _fill(self, header: bytearray, end: int, tail: bytes) -> None:
        """Fill counts, bounds and the places of the tail into the header."""
        minor, count, rows, flavour = header[25], len(self.rows), self.rows, self.flavour
        mask = 0x0F if flavour.point_format >= 6 else 0x07
        returns = np.bincount(np.clip(rows["returns"] & mask, 0, 15), minlength=16)[1:]
        if minor < _NEWEST or flavour.point_format < 6:
            struct.pack_into("<I5I", header, 107, count, *returns[:5].tolist())
        if minor >= _NEWEST:
            if flavour.point_format >= 6:
                struct.pack_into("<I5I", header, 107, 0, 0, 0, 0, 0, 0)
            struct.pack_into("<Q15Q", header, 247, count, *returns.tolist())
            struct.pack_into("<Q", header, 235, end if tail else 0)
        if minor >= 3:
            (wave,) = struct.unpack_from("<Q", header, 227)
            if wave >= flavour.tail_start > 0:
                struct.pack_into("<Q", header, 227, wave - flavour.tail_start + end)
        bounds = []
        for index, axis in enumerate("XYZ"):
            for stored in (rows[axis].max(), rows[axis].min()):
                bounds.append(float(stored) * self.grid.scales[index] + self.grid.offsets[index])
        struct.pack_into("<3d3d6d", header, 131, *self.grid.scales, *self.grid.offsets, *bounds)


def _laszip(compressor: Compressor) -> Record:
    return Record(b"laszip encoded", 22204, b"", compressor.record)


def _undocumented(extra: Extra) -> bytes:
    """Return an entry for bytes that the file did not list."""
    return EXTRA_ENTRY.pack(b"", 0, min(extra.count, 255), extra.name.encode()[:32], *[b""] * 6, b"")


def _count(tail: bytes) -> int:
    """Return the number of extended records."""
    at = count = 0
    while at + EVLR.size <= len(tail):
        at += EVLR.size + EVLR.unpack_from(tail, at)[3]
        count += 1
    return count
