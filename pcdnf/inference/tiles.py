"""A cloud on its way through a denoiser: frame of reference in float64, spatial order, tiles and their results."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..geometry.patches import PatchSource
from ..geometry.patches_cuda import DevicePatchSource
from ..geometry.patches_local import LocalPatchSource
from .local_pass import LocalPass
from .plan import Plan
from .results import TileResult
from .unit_frame import UnitFrame

TILE = 16384
"""Points a tile."""


def tiles(count: int, size: int) -> list[tuple[int, int]]:
    """Ranges (start, stop) of ``size`` that cover ``count``."""
    return [(start, min(start + size, count)) for start in range(0, count, size)]


class Cloud:
    """A cloud made ready for one iteration.

    Attributes
    ----------
    points : ndarray, (N, 3) float64
        As given.
    normals : ndarray, (N, 3) float32
        Raw normals.
    frame : UnitFrame
    source : PatchSource or DevicePatchSource
    order : ndarray, (N,) int64
        Indices along a space-filling curve; a tile is a range of it.
    local : LocalPass, optional
        Where the radius differs from point to point; ``source`` is that of the distinct points then.
    """

    def __init__(
        self,
        points: NDArray[np.float64],
        normals: NDArray[np.float32],
        frame: UnitFrame,
        source: PatchSource | LocalPatchSource | DevicePatchSource,
        order: NDArray[np.int64],
        local: LocalPass | None = None,
    ) -> None:
        self.points, self.normals, self.frame, self.source, self.order = points, normals, frame, source, order
        self.local = local

    def __len__(self) -> int:
        return len(self.points)

    def noise(self, plan: Plan) -> NDArray[np.float64]:
        """Noise (N,) estimated around each point as it came, in the cloud's unit; one for all where the plan has."""
        return np.full(len(self), plan.scale.noise) if self.local is None else self.local.survey.noise(self.frame)

    def tiles(self, size: int = TILE) -> list[tuple[int, int]]:
        """Ranges (start, stop) of ``order`` that cover the cloud."""
        return tiles(len(self), size)


class TileDenoiser(Protocol):
    """Denoises a tile, as :meth:`pcdnf.denoiser.Denoiser.denoise_tile` does."""

    def __call__(self, cloud: Cloud, start: int, stop: int, *, progress: Callable[[int], None]) -> TileResult:
        """Denoise the points ``cloud.order[start:stop]``."""


def denoise_tiles(cloud: Cloud, denoise_tile: TileDenoiser, *, progress: Callable[[int], None]) -> TileResult:
    """Denoise a prepared cloud, tile after tile.

    Parameters
    ----------
    cloud : Cloud
        Of N points.
    denoise_tile : callable
    progress : callable
        Called with the points of the cloud that are done.

    Returns
    -------
    TileResult
        Of all points, in the order of the cloud.
    """
    count = len(cloud)
    points, normals, flagged = np.empty((count, 3)), np.empty((count, 3), np.float32), np.zeros(count, bool)
    for start, stop in cloud.tiles():

        def step(done: int, before: int = start) -> None:
            progress(before + done)

        tile, rows = denoise_tile(cloud, start, stop, progress=step), cloud.order[start:stop]
        points[rows], normals[rows], flagged[rows] = tile.points, tile.normals, tile.flagged
    return TileResult(points, normals, flagged)
