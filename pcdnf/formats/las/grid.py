"""The grid of whole numbers that LAS stores coordinates on."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..limits import bounds

FINEST = 1000
"""Steps of a new grid between two neighbouring points, at least."""
COARSEST = 20
"""Steps of a file's own grid between two neighbouring points, under which it is refined."""

_MOST = 2**31 - 1


@dataclass(frozen=True)
class Grid:
    """``stored * scale + offset`` is a coordinate."""

    scales: tuple[float, float, float] = (0.001, 0.001, 0.001)
    offsets: tuple[float, float, float] = (0.0, 0.0, 0.0)


def grid_for(points: NDArray[Any], known: Grid | None) -> tuple[Grid, list[str]]:
    """Return the grid to store points on: that of the file, unless it is too coarse or does not reach them.

    Parameters
    ----------
    points : (N, 3) float array
    known : Grid or None
        None for a cloud that had none.

    Returns
    -------
    grid : Grid
    notes : list of str
        What was changed of ``known``.
    """
    least, most = bounds(points)
    spacing = math.hypot(*(most - least).tolist()) / math.sqrt(len(points))  # of points on a surface, about
    scales, offsets, changed = [], [], []
    for axis in range(3):
        scale = abs(known.scales[axis]) if known else math.inf
        offset = known.offsets[axis] if known else 0.0
        reach = max(abs(least[axis] - offset), abs(most[axis] - offset))
        if known and scale <= spacing / COARSEST and reach / scale < _MOST:
            scales.append(known.scales[axis])
            offsets.append(offset)
            continue
        step = 10.0 ** math.floor(math.log10(max(most[axis] - least[axis], spacing)))
        offset = float(round((least[axis] + most[axis]) / 2 / step) * step)
        reach = max(abs(least[axis] - offset), abs(most[axis] - offset))
        fine = min(scale, spacing / (COARSEST if known else FINEST))
        fine = max(fine, reach / _MOST * 2)
        fresh = 10.0 ** math.floor(math.log10(fine))
        scales.append(fresh if reach / fresh < _MOST else fresh * 10)
        offsets.append(offset)
        changed.append("xyz"[axis])
    notes = []
    if known and changed:
        notes.append(
            f"The grid of the file was too coarse for these points, or did not reach them: {', '.join(changed)} "
            f"{'is' if len(changed) == 1 else 'are'} stored with a scale of {scales['xyz'.index(changed[0])]:g}."
        )
    return Grid((scales[0], scales[1], scales[2]), (offsets[0], offsets[1], offsets[2])), notes


def snapped(points: NDArray[Any], grid: Grid) -> NDArray[np.int32]:
    """Return the whole numbers nearest to coordinates, (N, 3)."""
    moved = points.astype(np.float64) - np.array(grid.offsets)
    return np.asarray(np.rint(moved / np.array(grid.scales)), np.int32)
