"""Uniform grid for ball queries: all points within a radius, or a random subset of them.

Points are sorted by cell (x slowest, z fastest), so the 27 cells around a query are nine contiguous runs. Only the
occupied cells are stored. A random subset is a partial Fisher-Yates shuffle driven by a generator seeded with
(seed, index of the centre): a point's neighbours never depend on tiles, batches or threads.
"""

from __future__ import annotations

import numba as nb
import numpy as np
from numpy.typing import NDArray

CHOICE = 4
"""Points of a cell for each that is drawn from a ball: of fuller cells the grid keeps a random subset."""
STEPS = 2
"""Grids an octave of radii."""
SMALLEST_CELL = 1e-6
"""Of a grid, as a share of the cloud's size: the numbers of cells must fit 64 bits."""


class BallGrid:
    """Ball queries of one fixed radius.

    Parameters
    ----------
    points : ndarray, (N, 3) float
    radius : float
        In the unit of the points; also the size of a cell.
    crowd : int
        Points from which on a cell, and those around it, are thinned to a random subset: time and memory stay linear
        in a dense cloud.
    rows : ndarray, (R,) int64, optional
        Points to hold, ascending; all where not given.

    Attributes
    ----------
    order : ndarray, (S,) int64
        Rows of the points that are kept, cell by cell.
    points : ndarray, (S, 3) float64
        Those points.
    keys, starts : ndarray, (C,) and (C + 1,) int64
        Numbers of the occupied cells, ascending, and where each one's points begin.
    origin, dims : ndarray, (3,)
        Corner of the first cell, and how many cells there are a coordinate.
    """

    def __init__(
        self,
        points: NDArray[np.floating],
        radius: float,
        *,
        crowd: int,
        rows: NDArray[np.int64] | None = None,
    ) -> None:
        self.radius = float(radius)
        held = points if rows is None else points[rows]
        self.origin = held.min(0).astype(np.float64)
        cells = np.floor((held - self.origin) / self.radius).astype(np.int64)
        self.dims = cells.max(0) + 1
        keys = (cells[:, 0] * self.dims[1] + cells[:, 1]) * self.dims[2] + cells[:, 2]
        self.order = np.argsort(keys, kind="stable")
        self.keys, counts = _runs(keys[self.order])
        if counts.max() > crowd:
            share = crowd / _most_around(self.keys, counts, self.dims)
            kept = np.random.default_rng(0).random(len(keys))[self.order] < np.repeat(share, counts)
            self.order = self.order[kept]
            self.keys, counts = _runs(keys[self.order])
        self.starts = np.append(0, np.cumsum(counts))
        self.points = np.ascontiguousarray(held[self.order], dtype=np.float64)
        if rows is not None:
            self.order = rows[self.order]

    def subset(
        self,
        centres: NDArray[np.floating],
        ids: NDArray[np.integer],
        count: int,
        *,
        seed: int,
        inner: NDArray[np.floating] | None = None,
        reach: NDArray[np.floating] | None = None,
    ) -> NDArray[np.int64]:
        """Draw neighbours of each centre without replacement.

        Parameters
        ----------
        centres : ndarray, (B, 3) float
        ids : ndarray, (B,) int
            Index of each centre; never drawn itself.
        count : int
            Neighbours wanted a centre.
        seed : int
            Together with ``ids`` it decides the subset.
        inner : ndarray, (B,) float, optional
            Points not farther than this from the centre are left out.
        reach : ndarray, (B,) float, optional
            Radius of each centre's ball, at most the grid's, which it is where not given.

        Returns
        -------
        ndarray, (B, count) int64
            Indices of points; -1 behind the last one where the ball holds fewer.
        """
        out = np.empty((len(centres), count), np.int64)
        hole = np.full(len(centres), -1.0) if inner is None else np.asarray(inner, np.float64)
        limit = np.full(len(centres), self.radius) if reach is None else np.asarray(reach, np.float64)
        _subset(
            self.points,
            self.order,
            self.keys,
            self.starts,
            self.dims,
            self.origin,
            self.radius,
            np.ascontiguousarray(centres, np.float64),
            np.asarray(ids, np.int64),
            hole,
            limit,
            np.uint64(seed & 0xFFFFFFFFFFFFFFFF),
            out,
        )
        return out


class BallGrids:
    """Ball queries with a radius for each point, on grids whose cells differ by steps of half an octave.

    Parameters
    ----------
    points : ndarray, (N, 3) float64
    radius : ndarray, (N,) float64
        Of the balls around each point, in the unit of the points.
    crowd : int
        See :class:`BallGrid`.

    Attributes
    ----------
    step : ndarray, (N,) int64
        Which grid the ball of a point is found on.
    grids : dict of int to BallGrid
        Each holds the points within a cell of those whose balls it finds.
    """

    def __init__(self, points: NDArray[np.float64], radius: NDArray[np.float64], *, crowd: int) -> None:
        self.points, self.radius = points, radius
        least = float(np.ptp(points, axis=0).max()) * SMALLEST_CELL
        self.step = np.ceil(np.log2(np.maximum(radius, least)) * STEPS - 1e-9).astype(np.int64)
        self.grids = {}
        for step in np.unique(self.step).tolist():
            cell = float(np.exp2(step / STEPS)) * (1 + 1e-9)
            rows = _rows_near(points, self.step == step, cell)
            self.grids[step] = BallGrid(points, cell, crowd=crowd, rows=rows)

    def subset(self, rows: NDArray[np.int64], count: int, *, seed: int) -> NDArray[np.int64]:
        """Draw neighbours (B, count) int64 of the points ``rows`` (B,); see :meth:`BallGrid.subset`."""
        out = np.empty((len(rows), count), np.int64)
        steps = self.step[rows]
        for step in np.unique(steps).tolist():
            at = np.flatnonzero(steps == step)
            own = rows[at]
            out[at] = self.grids[step].subset(self.points[own], own, count, seed=seed, reach=self.radius[own])
        return out


def _rows_near(points: NDArray[np.float64], member: NDArray[np.bool_], cell: float) -> NDArray[np.int64] | None:
    """Rows of the points in the cells of the members (N,) and the cells around these; None for all."""
    if member.all():
        return None
    cells = np.floor((points - points.min(0)) / cell).astype(np.int64) + 1
    dims = cells.max(0) + 2
    keys = (cells[:, 0] * dims[1] + cells[:, 1]) * dims[2] + cells[:, 2]
    steps = np.array([(x * dims[1] + y) * dims[2] + z for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)])
    near = np.unique(np.unique(keys[member])[:, None] + steps)
    at = np.minimum(np.searchsorted(near, keys), len(near) - 1)
    return np.flatnonzero(near[at] == keys)


def _runs(keys: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Different values of sorted keys, and how many there are of each."""
    starts = np.flatnonzero(np.append(True, keys[1:] != keys[:-1]))
    return keys[starts], np.diff(np.append(starts, len(keys)))


def _most_around(keys: NDArray[np.int64], counts: NDArray[np.int64], dims: NDArray[np.int64]) -> NDArray[np.int64]:
    """Points in the fullest of a cell and the cells around it, for each: all that a ball touches is thinned alike."""
    x, y, z = keys // (dims[1] * dims[2]), keys // dims[2] % dims[1], keys % dims[2]
    most = counts.copy()
    for dx, dy, dz in np.ndindex(3, 3, 3):
        near = np.stack([x + dx - 1, y + dy - 1, z + dz - 1])
        inside = ((near >= 0) & (near < dims[:, None])).all(0)
        key = (near[0] * dims[1] + near[1]) * dims[2] + near[2]
        at = np.minimum(np.searchsorted(keys, key), len(keys) - 1)
        most = np.maximum(most, np.where(inside & (keys[at] == key), counts[at], 0))
    return most


@nb.njit(cache=True, nogil=True)
def _mix(x):  # type: ignore[no-untyped-def]
    """One step of splitmix64: a uint64 to a well-mixed uint64."""
    x = np.uint64(x) + np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


@nb.njit(cache=True, nogil=True, parallel=True)
def _subset(points, order, keys, starts, dims, origin, radius, centres, ids, inner, limit, seed, out):  # type: ignore[no-untyped-def]
    count = out.shape[1]
    chunk = 64
    for block in nb.prange((len(centres) + chunk - 1) // chunk):
        found = np.empty(2048, np.int64)
        for b in range(block * chunk, min((block + 1) * chunk, len(centres))):
            x, y, z = centres[b, 0], centres[b, 1], centres[b, 2]
            cx = int(np.floor((x - origin[0]) / radius))
            cy = int(np.floor((y - origin[1]) / radius))
            cz = int(np.floor((z - origin[2]) / radius))
            reach = limit[b] * limit[b]
            hole = inner[b] * inner[b] if inner[b] >= 0 else -1.0
            total = 0
            for ix in range(max(cx - 1, 0), min(cx + 2, dims[0])):
                for iy in range(max(cy - 1, 0), min(cy + 2, dims[1])):
                    row = (ix * dims[1] + iy) * dims[2]
                    low = row + max(cz - 1, 0)
                    high = row + min(cz + 2, dims[2])
                    if high <= low:
                        continue
                    first = starts[np.searchsorted(keys, low)]
                    last = starts[np.searchsorted(keys, high)]
                    if total + last - first > len(found):
                        grown = np.empty(2 * (total + last - first), np.int64)
                        for i in range(total):
                            grown[i] = found[i]
                        found = grown
                    for j in range(first, last):
                        dx, dy, dz = points[j, 0] - x, points[j, 1] - y, points[j, 2] - z
                        square = dx * dx + dy * dy + dz * dz
                        found[total] = order[j]  # and kept by counting it: a branch would be guessed wrong too often
                        total += (square <= reach) & (square > hole) & (order[j] != ids[b])
            state = _mix(seed ^ _mix(np.uint64(ids[b])))
            for i in range(count):
                if i >= total:
                    out[b, i] = -1
                    continue
                if total > count:
                    state = _mix(state)
                    pick = i + int(state % np.uint64(total - i))
                    found[i], found[pick] = found[pick], found[i]
                out[b, i] = found[i]
