"""LZF, the compression of PCD files, in the direction of the writer; ``lzf.py`` is the other and says how it works."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

_LONGEST_RUN, _LONGEST_COPY, _FARTHEST = 32, 264, 8192
_HASH_BITS = 14

_jit: Any = numba.njit(cache=True, nogil=True)


def compress(data: NDArray[np.uint8]) -> bytes:
    """Bytes that :func:`pcdnf.formats.pcd.lzf.decompress` turns back into ``data``; at most a 32nd longer."""
    out = np.empty(len(data) + len(data) // _LONGEST_RUN + 16, np.uint8)
    return bytes(out[: _compress(data, out)])


@_jit
def _compress(data, out):  # type: ignore[no-untyped-def]
    places = np.full(1 << _HASH_BITS, -1, np.int64)
    at = literal = size = 0
    while at < len(data):
        length = source = 0
        if at + 2 < len(data):
            key = (np.int64(data[at]) << 16) | (np.int64(data[at + 1]) << 8) | np.int64(data[at + 2])
            slot = ((key * 2654435761) >> 16) & ((1 << _HASH_BITS) - 1)
            source = places[slot]
            places[slot] = at
            if source >= 0 and at - source <= _FARTHEST:
                while length < _LONGEST_COPY and at + length < len(data) and data[source + length] == data[at + length]:
                    length += 1
        if length < 3:
            at += 1
            if at - literal == _LONGEST_RUN or at == len(data):
                size = _put_literals(data, literal, at, out, size)
                literal = at
            continue
        size = _put_literals(data, literal, at, out, size)
        distance, rest = at - source - 1, length - 2
        out[size] = (min(rest, 7) << 5) | (distance >> 8)
        size += 1
        if rest >= 7:
            out[size] = rest - 7
            size += 1
        out[size] = distance & 255
        size += 1
        at += length
        literal = at
    return size


@_jit
def _put_literals(data, start, stop, out, size):  # type: ignore[no-untyped-def]
    if stop > start:
        out[size] = stop - start - 1
        out[size + 1 : size + 1 + stop - start] = data[start:stop]
        size += 1 + stop - start
    return size
