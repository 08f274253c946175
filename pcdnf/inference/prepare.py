"""A cloud made ready for one iteration: raw normals, search structures, spatial order."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..geometry.morton import spatial_order
from ..geometry.noise import normals_reach
from ..geometry.normals import raw_normals
from ..geometry.patches import PatchSource
from ..geometry.patches_cuda import DevicePatchSource
from ..geometry.recipe import Recipe
from .device import room_for
from .options import InitialNormals
from .plan import Plan
from .runner import FEWEST_NEIGHBOURS, ShouldStop, Stopped
from .tiles import Cloud
from .unit_frame import Frame


def prepare_cloud(
    points: NDArray[np.float64],
    normals: NDArray[np.floating] | None,
    recipe: Recipe,
    *,
    plan: Plan,
    iteration: int,
    frame: Frame,
    initial: InitialNormals,
    seed: int,
    device: str,
    should_stop: ShouldStop | None,
) -> Cloud:
    """Prepare points (N, 3) for an iteration of a plan; see :meth:`pcdnf.denoiser.Denoiser.prepare`.

    Raises
    ------
    DeviceError
        ``out_of_memory``.
    Stopped
    """
    local = frame.to_local(points)
    radius = plan.radii[iteration] / frame.diagonal
    count = recipe.points if plan.neighbours is None else min(plan.neighbours, recipe.points)
    recipe = replace(recipe, points=count, radius=radius, fewest=FEWEST_NEIGHBOURS + 10)
    tree = cKDTree(local)

    def check() -> None:
        if should_stop is not None and should_stop():
            raise Stopped

    reach = 0.0
    if recipe.normals == "ball" and initial != "pca":
        reach = normals_reach(radius, plan.scale.scaled(1 / frame.diagonal))
    raw = raw_normals(local, normals, tree=tree, reach=reach, replace=initial != "input", check=check)
    source: PatchSource | DevicePatchSource
    source = PatchSource(local, raw, recipe, diagonal=1.0, seed=seed, tree=tree)
    if device != "cpu" and recipe.kind == "ball":
        with room_for("the cloud"):
            source = DevicePatchSource(source, device=device)
    return Cloud(points, raw, frame, source, spatial_order(local))
