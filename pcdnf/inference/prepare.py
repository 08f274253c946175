"""A cloud made ready for one iteration: raw normals, search structures, spatial order."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..geometry.morton import spatial_order
from ..geometry.noise import normals_reach
from ..geometry.normals import raw_normals
from ..geometry.patches import PatchSource
from ..geometry.patches_cuda import DevicePatchSource
from ..geometry.patches_local import LocalPatchSource
from ..geometry.recipe import Recipe
from ..geometry.sides import tell_sides
from .device import room_for
from .local_pass import LocalPass
from .options import InitialNormals
from .plan import CLEAN, Plan, local_radius, needs_pass
from .runner import FEWEST_NEIGHBOURS, ShouldStop, StoppedError
from .survey import Survey
from .tiles import Cloud
from .unit_frame import UnitFrame

NORMALS = 2.5
"""Radius of the balls that initial normals are taken from, in noises around the point, where it is not smaller."""


def prepare_cloud(
    points: NDArray[np.float64],
    normals: NDArray[np.floating] | None,
    recipe: Recipe,
    *,
    plan: Plan,
    iteration: int,
    frame: UnitFrame,
    initial: InitialNormals,
    seed: int,
    device: str,
    should_stop: ShouldStop | None,
    survey: Survey | None = None,
    oriented: bool = True,
) -> Cloud:
    """Prepare points (N, 3) for an iteration of a plan; see :meth:`pcdnf.denoiser.Denoiser.prepare`.

    ``survey`` is that of the cloud as it came, where the plan is a local one.

    Raises
    ------
    DeviceError
        ``out_of_memory``.
    StoppedError
    """
    count = recipe.points if plan.neighbours is None else min(plan.neighbours, recipe.points)

    def check() -> None:
        if should_stop is not None and should_stop():
            raise StoppedError

    if survey is not None:
        recipe = replace(recipe, points=count)
        return _prepare_local(points, normals, recipe, survey, iteration, frame, initial, seed, device, oriented, check)
    local = frame.to_local(points)
    radius = plan.radii[iteration] / frame.diagonal
    recipe = replace(recipe, points=count, radius=radius, fewest=FEWEST_NEIGHBOURS + 10)
    tree = cKDTree(local)
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


def _prepare_local(
    points: NDArray[np.float64],
    normals: NDArray[np.floating] | None,
    recipe: Recipe,
    survey: Survey,
    iteration: int,
    frame: UnitFrame,
    initial: InitialNormals,
    seed: int,
    device: str,
    oriented: bool,
    check: Callable[[], None],
) -> Cloud:
    """Prepare the distinct points of a cloud (N, 3) for an iteration, each with a radius by the noise around it."""
    rows, scale = survey.distinct.rows, survey.scale
    here = points[rows]
    local = frame.to_local(here)
    tree = cKDTree(local)
    given = None if normals is None else normals[rows]
    radius = local_radius(scale, recipe) * (recipe.later if iteration else 1.0)
    reach: float | NDArray[np.float64] = 0.0
    if recipe.normals == "ball" and initial != "pca":
        reach = np.minimum(radius, np.maximum.reduce([0.4 * radius, NORMALS * scale.noise, 2.5 * scale.spacing]))
    raw = raw_normals(local, given, tree=tree, reach=reach, replace=initial != "input", check=check)
    sided = oriented and given is not None and tell_sides(local, raw, tree)
    active = needs_pass(scale, iteration)
    if sided and iteration < 2:
        active |= scale.double & (scale.ratio >= CLEAN)
    source: LocalPatchSource | DevicePatchSource
    source = LocalPatchSource(local, raw, recipe, radius=radius, noise=scale.noise, seed=seed, sided=sided)
    if device != "cpu":
        with room_for("the cloud"):
            source = DevicePatchSource(source, device=device)
    fine = ~active if iteration == 0 else np.zeros(len(rows), bool)
    work = LocalPass(survey, here, raw, active, fine, tree)
    spread = np.append(raw, np.array([[0, 0, 1]], np.float32), axis=0)[survey.distinct.of]
    return Cloud(points, spread, frame, source, spatial_order(frame.to_local(points)), work)
