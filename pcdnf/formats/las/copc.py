"""COPC: a LAZ whose chunks are the nodes of an octree, with an index of them at its end. COPC 1.0.

https://copc.io. Any reader of LAZ reads such a file; readers of COPC take from it what they show.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .grid import Grid, snapped
from .header import EVLR, Record

USER, INFO, HIERARCHY = b"copc", 1, 1000
FORMATS = (6, 7, 8)
"""Point formats that a COPC may have."""

CELLS = 128
"""Cells of a node along each axis; a node that has nodes below holds one point a cell."""
LEAF_POINTS = 20_000
"""A node with at most as many points has none below."""
DEEPEST = 20

_INFO = struct.Struct("<5d2Q2d88x")
_ENTRY = struct.Struct("<4iQii")
_HEADER_SIZE = 375


@dataclass(frozen=True)
class Octree:
    """Points by nodes.

    Attributes
    ----------
    order : (N,) int64 array
        The points, node after node.
    keys : (M, 4) int64 array
        Level, x, y, z of each node.
    counts : (M,) int64 array
        Points of each node.
    centre : (3,) float64 array
    half : float
        Half of the length of the root's edges.
    """

    order: NDArray[np.int64]
    keys: NDArray[np.int64]
    counts: NDArray[np.int64]
    centre: NDArray[np.float64]
    half: float


def octree(points: NDArray[Any], grid: Grid) -> Octree:
    """Return the nodes of points (N, 3), after rounding to the grid they are stored on.

    The upper nodes hold a thinned-out cloud, those below what is left, as COPC asks for. The order of points that
    are in order already does not change.
    """
    stored = snapped(points, grid) * np.array(grid.scales) + np.array(grid.offsets)
    low, high = stored.min(axis=0), stored.max(axis=0)
    centre = (low + high) / 2
    half = float((high - low).max()) / 2 + max(map(abs, grid.scales))
    unit = np.clip((stored - (centre - half)) / (2 * half), 0, np.nextafter(1, 0))
    level = np.full(len(points), -1)
    node = np.zeros((len(points), 3), np.int64)
    rest = np.arange(len(points))
    for depth in range(DEEPEST + 1):
        places = (unit[rest] * 2**depth).astype(np.int64)
        _, where, counts = np.unique(_code(places), return_inverse=True, return_counts=True)
        taken = counts[where] <= LEAF_POINTS
        if depth < DEEPEST:
            cells = (unit[rest] * (CELLS * 2**depth)).astype(np.int64)
            _, first = np.unique(_code(cells), return_index=True)
            taken[first] = True
        else:
            taken[:] = True
        level[rest[taken]], node[rest[taken]] = depth, places[taken]
        rest = rest[~taken]
        if not rest.size:
            break
    order = np.lexsort((np.arange(len(points)), node[:, 2], node[:, 1], node[:, 0], level))
    keys = np.column_stack([level, node])[order]
    starts = np.flatnonzero(np.r_[True, (np.diff(keys, axis=0) != 0).any(axis=1)])
    return Octree(order, keys[starts], np.diff(np.r_[starts, len(points)]), centre, half)


def _code(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """One number a cell, the same for equal cells only."""
    if cells.size and int(cells.max()) >= 2**21:
        _, numbers = np.unique(cells, axis=0, return_inverse=True)
        return np.asarray(numbers.reshape(-1), np.int64)
    code: NDArray[np.int64] = (cells[:, 0] << 42) | (cells[:, 1] << 21) | cells[:, 2]
    return code


def info_record(tree: Octree, times: NDArray[np.float64], hierarchy: int) -> Record:
    """Return the first record of a COPC: the cube of the root, its spacing, and the place of the index."""
    data = _INFO.pack(
        *tree.centre,
        tree.half,
        2 * tree.half / CELLS,
        hierarchy,
        len(tree.keys) * _ENTRY.size,
        float(times.min()),
        float(times.max()),
    )
    return Record(USER, INFO, b"COPC info VLR", data)


def hierarchy_record(tree: Octree, offsets: list[int]) -> bytes:
    """Return the extended record of the index: one page with all nodes.

    Parameters
    ----------
    tree : Octree
    offsets : list of int
        Where the chunk of each node begins in the file, and where the last one ends.
    """
    entries = b"".join(
        _ENTRY.pack(*key, offset, end - offset, count)
        for key, offset, end, count in zip(
            tree.keys.tolist(), offsets[:-1], offsets[1:], tree.counts.tolist(), strict=True
        )
    )
    return EVLR.pack(b"", USER, HIERARCHY, len(entries), b"EPT hierarchy") + entries


def is_copc(records: tuple[Record, ...]) -> bool:
    """Whether a file claims to be a COPC."""
    return any(record.user == USER for record in records)


def without_copc(records: tuple[Record, ...], tail: bytes) -> tuple[tuple[Record, ...], bytes, int]:
    """Return records and extended records without those of COPC, and the number of remaining extended records."""
    kept, count, at = [], 0, 0
    while at + EVLR.size <= len(tail):
        _, user, _, length, _ = EVLR.unpack_from(tail, at)
        if user.rstrip(b"\0") != USER:
            kept.append(tail[at : at + EVLR.size + length])
            count += 1
        at += EVLR.size + length
    return tuple(record for record in records if record.user != USER), b"".join(kept), count
