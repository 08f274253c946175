"""The compressed points of a LAZ: what they declare is walked through before ``lazrs`` takes memory for it.

A chunk of the layered formats (6 and up) begins with one point and a count, then the size of each layer; the library
allocates a layer on the word of that size.
"""

from __future__ import annotations

import io
import struct
from typing import Any, BinaryIO, NoReturn

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError, check_available
from ..limits import Limits
from .header import Header

MAX_RATIO = 100
"""Bytes a byte of a LAZ may inflate to, beyond the first ``FREE_BYTES``; surveys reach 20."""
FREE_BYTES = 16 * 1024**2

_FIXED = struct.Struct("<HHBBHIIqqH")
_ITEM = struct.Struct("<HHH")
_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}
"""Layers of the items of points, colours, colours with infrared, and wave packets; extra bytes (14) have one a byte."""
_EXTRA_BYTES = 14
_LAYERED = 3
_POINTWISE, _CHUNKED = 1, 2
_CHUNK_AT = 12
_VARIABLE = 2**32 - 1
_NEWEST_ITEMS = 3
_ROWS_PER_WRITE = 1 << 18


def inflated(file: BinaryIO, header: Header, size: int, limits: Limits) -> bytearray:
    """Read the records of a LAZ of `size` bytes; the file must be positioned at the first of them.

    Raises
    ------
    FormatError
        ``missing_extra``, ``bad_header``, ``file_too_large``, ``compression_ratio`` or ``corrupt_archive``.
    """
    check_available("laz")
    import lazrs

    _check_versions(header)
    chunk, layers = _check_items(header, lazrs)
    total = header.count * header.stride
    for limit, code, what in (
        (limits.max_bytes, "file_too_large", "the limit is {limit}"),
        (FREE_BYTES + MAX_RATIO * size, "compression_ratio", "from {size}, far more than surveys do"),
    ):
        if total > limit:
            raise FormatError(
                f"The LAZ inflates to {total} bytes, {what.format(limit=limit, size=size)}.",
                code=code,
                hint="Send fewer points, or an uncompressed LAS.",
                limit=limit,
                actual=total,
            )
    if layers:
        _check_layers(file, header, chunk, layers)
    file.seek(header.start)
    data = bytearray(total)
    try:
        source, record = _chunked(file, header, lazrs)
        lazrs.LasZipDecompressor(source, record).decompress_many(data)
    except (FormatError, MemoryError, KeyboardInterrupt, SystemExit):
        raise
    except BaseException:  # its panics are no Exception
        _damaged()
    return data


def _chunked(file: BinaryIO, header: Header, lazrs: Any) -> tuple[BinaryIO, bytes]:
    """Return the compressed points and their record in the form that `lazrs` takes.

    It knows variable chunks by one of their two marks, and points that are not in chunks (LASzip 1) not at all:
    these are given to it as a single chunk.
    """
    record = bytearray(header.compression)
    compressor, _, _, _, _, _, chunk, *_ = _FIXED.unpack_from(record)
    if chunk == 0:
        struct.pack_into("<I", record, _CHUNK_AT, _VARIABLE)
    if compressor != _POINTWISE:
        return file, bytes(record)
    struct.pack_into("<H", record, 0, _CHUNKED)
    struct.pack_into("<I", record, _CHUNK_AT, header.count)
    stream = file.read(header.end - header.start)
    whole = io.BytesIO(struct.pack("<q", header.start + 8 + len(stream)) + stream)
    shifted = io.BytesIO(bytes(header.start) + whole.getvalue())
    shifted.seek(0, io.SEEK_END)
    lazrs.write_chunk_table(shifted, [(header.count, len(stream))], lazrs.LazVlr(bytes(record)))
    shifted.seek(header.start)
    return shifted, bytes(record)


def _check_versions(header: Header) -> None:
    """Say of a compression that is newer than the library that it is newer, not that the file is damaged."""
    newest = max((version for _, _, version in _ITEM.iter_unpack(header.compression[_FIXED.size :])), default=0)
    if newest > _NEWEST_ITEMS:
        raise FormatError(
            f"The LAZ is compressed by a newer LASzip (items of version {newest}); up to {_NEWEST_ITEMS} can be read.",
            code="unsupported_compression",
            hint="Convert it to an uncompressed LAS, or compress it with LASzip 3.4.",
            limit=_NEWEST_ITEMS,
            actual=newest,
        )


def _items(data: bytes) -> list[tuple[int, int]]:
    """(type, size) of each item of a record on compression."""
    return [_ITEM.unpack_from(data, at)[:2] for at in range(_FIXED.size, len(data) - _ITEM.size + 1, _ITEM.size)]


def _check_items(header: Header, lazrs: Any) -> tuple[int, int]:
    """Points of a chunk, and its layers, 0 where there are none."""
    compressor, _, _, _, _, _, chunk, _, _, _ = _FIXED.unpack_from(header.compression)
    expected = _record(header.point_format, sum(extra.size for extra in header.extras), lazrs)
    if expected is None or _items(bytes(expected.record_data())) != _items(header.compression):
        raise FormatError(
            f"The LAZ compresses point format {header.point_format} in an unknown way.",
            code="bad_header",
            hint="Convert it to an uncompressed LAS.",
        )
    chunk = chunk or _VARIABLE
    if compressor != _LAYERED:
        return chunk, 0
    return chunk, sum(_LAYERS.get(kind, size) for kind, size in _items(header.compression))


def _record(point_format: int, extra_bytes: int, lazrs: Any, variable: bool = False) -> Any:
    """Return the description of a point for `lazrs`; None if it cannot compress such points."""
    try:
        return lazrs.LazVlr.new_for_compression(point_format, extra_bytes, variable)
    except (lazrs.LazrsError, ValueError, OverflowError):
        return None


def _check_layers(file: BinaryIO, header: Header, chunk: int, layers: int) -> None:
    position, left = header.start + 8, header.count
    head = header.stride + 4 + 4 * layers
    while left > 0:
        file.seek(position)
        sizes = file.read(head)[header.stride :]
        if len(sizes) < 4 + 4 * layers:
            _damaged()
        count, *lengths = struct.unpack(f"<{1 + layers}I", sizes)
        position += head + sum(lengths)
        if position > header.end or (chunk == _VARIABLE and count == 0):
            _damaged()
        left -= count if chunk == _VARIABLE else chunk


def _damaged() -> NoReturn:
    raise FormatError(
        "The compressed points of the LAZ are inconsistent, or end early.",
        code="corrupt_archive",
        hint="The file is damaged: copy or export it again.",
    )


class Compressor:
    """Writes records as LAZ.

    Parameters
    ----------
    point_format, extra_bytes : int
        Of a record.
    variable : bool
        Whether chunks have numbers of points of their own.

    Raises
    ------
    FormatError
        ``missing_extra``, or ``cannot_store`` for points that ``lazrs`` does not compress.
    """

    def __init__(self, point_format: int, extra_bytes: int, *, variable: bool = False) -> None:
        check_available("laz")
        import lazrs

        self._lazrs = lazrs
        self._record = _record(point_format, extra_bytes, lazrs, variable)
        if self._record is None:
            raise FormatError(
                f"Points of format {point_format} cannot be compressed.",
                code="cannot_store",
                hint="Write an uncompressed LAS.",
            )

    @property
    def record(self) -> bytes:
        """The record on compression that the header needs."""
        return bytes(self._record.record_data())

    def write(self, file: BinaryIO, rows: NDArray[np.void]) -> None:
        """Write all records of a file that stands where the points begin."""
        compressor = self._lazrs.LasZipCompressor(file, self._record)
        for at in range(0, len(rows), _ROWS_PER_WRITE):
            compressor.compress_many(rows[at : at + _ROWS_PER_WRITE].tobytes())
        compressor.done()

    def write_chunks(self, file: BinaryIO, rows: NDArray[np.void], counts: NDArray[np.int64]) -> list[int]:
        """Write records in chunks of ``counts`` points; where each begins, and where the last one ends."""
        compressor = self._lazrs.LasZipCompressor(file, self._record)
        compressor.reserve_offset_to_chunk_table()
        places = [file.tell()]
        for stop, count in zip(np.cumsum(counts).tolist(), counts.tolist(), strict=True):
            compressor.compress_many(rows[stop - count : stop].tobytes())
            compressor.finish_current_chunk()
            places.append(file.tell())
        compressor.done()
        return places
