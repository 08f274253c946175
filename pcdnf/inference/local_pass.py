"""One pass over a cloud whose points are each treated by the noise around them.

Where the noise is a good part of the spacing, the network denoises; where it is less, :mod:`pcdnf.geometry.flat_fits`
does. No point moves further than its noise explains: one that would is left where it came.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..geometry.flat_fits import flat_fits
from ..geometry.normals import unit_towards
from ..geometry.patches import PatchSource
from ..geometry.patches_cuda import DevicePatchSource
from ..geometry.patches_local import LocalPatchSource
from .diagnostics import FARTHEST
from .results import TileResult
from .runner import Inference, ShouldStop, StoppedError
from .survey import Survey


@dataclass(frozen=True)
class LocalPass:
    """What a pass needs besides the patches; M distinct points.

    Attributes
    ----------
    survey : Survey
        Of the cloud as it came.
    points : ndarray, (M, 3) float64
        The distinct points as the pass before left them, in the cloud's unit.
    normals : ndarray, (M, 3) float32
        Their raw normals.
    active : ndarray, (M,) bool
        Points that the network denoises in this pass.
    fine : ndarray, (M,) bool
        Points that flat fits denoise in this pass.
    tree : cKDTree
        Of the points in the frame's unit.
    """

    survey: Survey
    points: NDArray[np.float64]
    normals: NDArray[np.float32]
    active: NDArray[np.bool_]
    fine: NDArray[np.bool_]
    tree: cKDTree


def denoise_rows(
    inference: Inference,
    work: LocalPass,
    source: PatchSource | LocalPatchSource | DevicePatchSource,
    rows: NDArray[np.int64],
    *,
    given: tuple[NDArray[np.float64], NDArray[np.float32]],
    unit: float,
    progress: Callable[[int], None] | None = None,
    should_stop: ShouldStop | None = None,
) -> TileResult:
    """Denoise some rows of a cloud; copies of a point get one result.

    Parameters
    ----------
    inference : Inference
    work : LocalPass
    source : PatchSource, LocalPatchSource or DevicePatchSource
        Of the distinct points.
    rows : ndarray, (n,) int64
        Rows of the cloud.
    given : tuple of ndarray, (N, 3) float64 and (N, 3) float32
        Points and normals of the cloud: what rows without a measurement keep.
    unit : float
        The frame's unit in that of the cloud.
    progress, should_stop : callable, optional
        See :meth:`pcdnf.denoiser.Denoiser.denoise_tile`.

    Raises
    ------
    DeviceError
    StoppedError
    """
    of = work.survey.distinct.of[rows]
    own = np.unique(of[of >= 0])
    moved, normals, flagged = work.points[own], work.normals[own].astype(np.float32), np.zeros(len(own), bool)
    by_network, by_fit = np.flatnonzero(work.active[own]), np.flatnonzero(work.fine[own])
    if len(by_network):

        def step(done: int) -> None:
            if progress is not None and done < len(by_network):
                progress(len(rows) * done // len(by_network))

        tile = inference.denoise(
            work.points, work.normals, source, own[by_network], unit=unit, progress=step, should_stop=should_stop
        )
        moved[by_network], normals[by_network], flagged[by_network] = tile.points, tile.normals, tile.flagged
    if len(by_fit):
        if should_stop is not None and should_stop():
            raise StoppedError
        chosen = own[by_fit]
        move, normal = flat_fits(work.tree.data, chosen, work.survey.scale.noise[chosen], tree=work.tree)
        moved[by_fit] += move * unit
        known = np.isfinite(normal).all(1)
        normals[by_fit[known]] = unit_towards(normal[known], normals[by_fit[known]])
    came = work.survey.points[own]
    far = np.linalg.norm(moved - came, axis=1) > FARTHEST * work.survey.scale.noise[own] * unit
    moved[far] = came[far]
    if progress is not None:
        progress(len(rows))
    return _of_rows(rows, of, own, TileResult(moved, normals, flagged), given)


def _of_rows(
    rows: NDArray[np.int64],
    of: NDArray[np.int64],
    own: NDArray[np.int64],
    result: TileResult,
    given: tuple[NDArray[np.float64], NDArray[np.float32]],
) -> TileResult:
    """Spread the results of the distinct points ``own`` over rows that stand for the points ``of`` (n,)."""
    points, normals, flagged = given[0][rows], given[1][rows], np.zeros(len(rows), bool)
    real = of >= 0
    at = np.searchsorted(own, of[real])
    points[real], normals[real], flagged[real] = result.points[at], result.normals[at], result.flagged[at]
    return TileResult(points, normals, flagged)
