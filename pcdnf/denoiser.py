"""Cloud in, cloud out: frames, tiles, batches and iterations around a network.

A cloud is centred and scaled by its bounding-box diagonal in float64; only differences inside a patch become
float32. A tile is a range of points along a space-filling curve. Every batch has the same shape (the last one is
filled up), a patch's frame is computed patch by patch, and random subsets depend on (seed, index) alone, so a
point's result does not depend on tiles, batches or workers.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor, nn

from ._version import __version__
from .geometry.recipe import Recipe
from .inference.device import choose_device, choose_precision
from .inference.diagnostics import diagnose
from .inference.local_pass import denoise_rows as denoise_local_rows
from .inference.options import InitialNormals, check_fast, check_initial, check_radius
from .inference.plan import Plan, iteration_seed, make_plan
from .inference.prepare import prepare_cloud
from .inference.results import DenoiseResult, TileResult
from .inference.runner import FEWEST_NEIGHBOURS, Inference, ShouldStop, Stopped, StoppedError
from .inference.survey import Survey, survey_cloud
from .inference.tiles import Cloud, denoise_tiles
from .inference.unit_frame import CloudError, UnitFrame, checked_normals, checked_points
from .models.build import trained_network
from .models.catalog import DEFAULT_MODEL, ModelInfo
from .models.checkpoint import load_checkpoint
from .models.lite import LiteOutput
from .models.pcdnf import NetworkOutput

__all__ = [
    "Cloud",
    "CloudError",
    "DenoiseResult",
    "Denoiser",
    "Frame",
    "Plan",
    "ShouldStop",
    "Stopped",
    "StoppedError",
    "TileResult",
    "UnitFrame",
    "iteration_seed",
]

Frame = UnitFrame
"""The older name."""
Progress = Callable[[int, int], None]


class Denoiser:
    """Denoises clouds with one network on one device.

    Parameters
    ----------
    network : nn.Module
        ``PCDNF`` or ``PCDNFLite``; switched to inference.
    recipe : Recipe
        How its patches are taken.
    info : ModelInfo, optional
        Of the checkpoint it came from.
    device, precision : str
        "cpu" or "cuda:N"; "float32" or "bfloat16".
    """

    def __init__(
        self,
        network: nn.Module,
        recipe: Recipe,
        *,
        info: ModelInfo | None = None,
        device: str = "cpu",
        precision: str = "float32",
    ) -> None:
        self.info, self.recipe, self.device, self.precision = info, recipe, device, precision
        self.inference = Inference(network, device=device, precision=precision)
        self.minimum_points = FEWEST_NEIGHBOURS + 10

    @classmethod
    def load(
        cls, name_or_path: str | os.PathLike[str] = DEFAULT_MODEL, *, device: str = "auto", precision: str = "auto"
    ) -> Denoiser:
        """Return a denoiser with a shipped model (by name) or a checkpoint (by path).

        Parameters
        ----------
        name_or_path : str or path
        device : str
            "auto" takes the first GPU, else the CPU; or "cpu", "cuda", "cuda:N".
        precision : {"auto", "float32", "bfloat16"}
            "auto" takes bfloat16 where the device computes it natively.

        Raises
        ------
        CheckpointError
            No such model, or a damaged one.
        DeviceError
            No such device, a precision it does not have, or no memory left there.
        """
        info, state = load_checkpoint(name_or_path)
        device = choose_device(device)
        precision = choose_precision(precision, device=device)
        network, recipe = trained_network(info, state)
        return cls(network, recipe, info=info, device=device, precision=precision)

    def network(self, points: Tensor, normals: Tensor) -> NetworkOutput | LiteOutput:
        """Run the network on patches in their frames; see :meth:`pcdnf.inference.runner.Inference.network`."""
        return self.inference.network(points, normals)

    @property
    def batch(self) -> int:
        """Patches a batch; halved when the device runs out of memory, until the next cloud is prepared."""
        return self.inference.batch

    @batch.setter
    def batch(self, value: int) -> None:
        self.inference.batch = value

    def warm_up(self) -> None:
        """Compile and touch everything on one small cloud."""
        grid = np.stack(np.meshgrid(np.arange(20.0), np.arange(20.0)), -1).reshape(-1, 2)
        self.denoise(np.c_[grid, 0.1 * np.random.default_rng(0).normal(size=len(grid))])

    def plan(
        self,
        points: NDArray[np.floating],
        *,
        iterations: int | str = "auto",
        radius: float | str = "auto",
        fast: bool = False,
    ) -> Plan:
        """Choose what the caller leaves open.

        See :func:`~pcdnf.inference.plan.make_plan` and :func:`~pcdnf.inference.options.check_fast`.

        Raises
        ------
        ChoiceError, CloudError
        """
        neighbours = check_fast(fast, self.inference.kind)
        given = checked_points(points, self.minimum_points)
        frame = UnitFrame.of(given)
        survey = self._survey(given, frame) if check_radius(radius) is None else None
        return self._plan(given, frame, survey, iterations=iterations, radius=radius, neighbours=neighbours)

    def _survey(self, points: NDArray[np.float64], frame: UnitFrame) -> Survey | None:
        """Noise and spacing around each point, where the network's radius may follow them."""
        return survey_cloud(points, frame) if self.recipe.local else None

    def _plan(self, points: NDArray[np.float64], frame: UnitFrame, survey: Survey | None, **choices: Any) -> Plan:
        scale = None if survey is None else survey.scale
        return make_plan(points, self.recipe, frame=frame, scale=scale, **choices)

    def prepare(
        self,
        points: NDArray[np.floating],
        normals: NDArray[np.floating] | None = None,
        *,
        plan: Plan | None = None,
        iteration: int = 0,
        frame: UnitFrame | None = None,
        initial: InitialNormals = "input",
        seed: int = 0,
        should_stop: ShouldStop | None = None,
        came: NDArray[np.floating] | None = None,
        oriented: bool = True,
        survey: Survey | None = None,
    ) -> Cloud:
        """Search structures, spatial order and raw normals of a cloud, for one iteration.

        Parameters
        ----------
        points : ndarray, (N, 3) float
        normals : ndarray, (N, 3) float, optional
            Normals of any length: the caller's for the first iteration, the last result's later. A row that is zero
            or not finite counts as missing.
        plan : Plan, optional
            Of the whole run, made for its first iteration's points; made here where not given.
        iteration : int
            Which one this is, from 0.
        frame : UnitFrame, optional
            The first iteration's; later ones keep its centre and scale.
        initial : {"input", "auto", "pca"}
            What the raw normals are: ``normals`` where there are any, PCA of a scale that suits the noise (where the
            network was trained so), or of 24 neighbours. Estimated ones take their sign from ``normals``.
        seed : int
            Of the random subsets, see :func:`iteration_seed`.
        should_stop : callable, optional
        came : ndarray, (N, 3) float, optional
            The first iteration's points, for a later one: no point goes further from there than its noise explains.
        oriented : bool
            Whether the signs of ``normals`` are the caller's, which may tell the sides of a wall apart.
        survey : Survey, optional
            Of those points; made here where it is needed and not given.

        Raises
        ------
        CloudError
            Other shapes, too few points, no extent, or one out of range, NaN or infinity.
        ChoiceError
            Another ``initial``.
        DeviceError
            Out of memory.
        StoppedError
        """
        given = checked_points(points, self.minimum_points)
        frame = UnitFrame.of(given) if frame is None else frame
        if survey is None and (plan is None or plan.local):
            survey = self._survey(given if came is None else checked_points(came, self.minimum_points), frame)
        if plan is None:
            plan = self._plan(given, frame, survey)
        self.inference.restore_batch()
        return prepare_cloud(
            given,
            checked_normals(normals, len(given)),
            self.recipe,
            plan=plan,
            iteration=iteration,
            frame=frame,
            initial=check_initial(initial),
            seed=seed,
            device=self.device,
            should_stop=should_stop,
            survey=survey if plan.local else None,
            oriented=oriented,
        )

    def denoise_tile(
        self,
        cloud: Cloud,
        start: int,
        stop: int,
        *,
        progress: Callable[[int], None] | None = None,
        should_stop: ShouldStop | None = None,
    ) -> TileResult:
        """Denoise the points ``cloud.order[start:stop]``; see :meth:`denoise_rows`."""
        return self.denoise_rows(cloud, cloud.order[start:stop], progress=progress, should_stop=should_stop)

    def denoise_rows(
        self,
        cloud: Cloud,
        rows: NDArray[np.int64],
        *,
        progress: Callable[[int], None] | None = None,
        should_stop: ShouldStop | None = None,
    ) -> TileResult:
        """Denoise some points of a prepared cloud.

        ``progress`` is called with how many are done so far, ``should_stop`` between batches.

        Raises
        ------
        DeviceError
            Out of memory with the smallest batch.
        StoppedError
        """
        if cloud.local is not None:
            return denoise_local_rows(
                self.inference,
                cloud.local,
                cloud.source,
                rows,
                given=(cloud.points, cloud.normals),
                unit=cloud.frame.diagonal,
                progress=progress,
                should_stop=should_stop,
            )
        return self.inference.denoise(
            cloud.points,
            cloud.normals,
            cloud.source,
            rows,
            unit=cloud.frame.diagonal,
            progress=progress,
            should_stop=should_stop,
        )

    def denoise(
        self,
        points: NDArray[np.floating],
        normals: NDArray[np.floating] | None = None,
        *,
        iterations: int | str = "auto",
        radius: float | str = "auto",
        fast: bool = False,
        initial: InitialNormals = "auto",
        seed: int = 0,
        progress: Progress | None = None,
        should_stop: ShouldStop | None = None,
    ) -> DenoiseResult:
        """Denoise a cloud.

        Parameters
        ----------
        points : ndarray, (N, 3) float
            In any unit and place; order and count are kept.
        normals : ndarray, (N, 3) float, optional
            The caller's, of any length: the result's lie on their side.
        iterations, radius
            See :func:`pcdnf.inference.plan.make_plan`. Each iteration takes points and normals of the one before.
        fast : bool
            Half as many neighbours a point, where the network can do with them: about 1.4 times as fast.
        initial : {"auto", "pca", "input"}
            Raw normals of the first iteration, see :meth:`prepare`.
        seed : int
            Of the random subsets of neighbours.
        progress : callable, optional
            Called with (done, total), in points times iterations.
        should_stop : callable, optional
            Polled between batches.

        Raises
        ------
        CloudError
            See :meth:`prepare`.
        ChoiceError
            See :mod:`pcdnf.inference.options`.
        DeviceError
            Out of memory with the smallest batch.
        StoppedError
            ``should_stop`` returned True.
        """
        given = checked_points(points, self.minimum_points)
        raw, initial = checked_normals(normals, len(given)), check_initial(initial)
        neighbours, frame = check_fast(fast, self.inference.kind), UnitFrame.of(given)
        survey = self._survey(given, frame) if check_radius(radius) is None else None
        plan = self._plan(given, frame, survey, iterations=iterations, radius=radius, neighbours=neighbours)
        merged = TileResult(given, np.empty(given.shape, np.float32), np.zeros(len(given), bool))
        total = plan.iterations * len(given)
        for iteration in range(plan.iterations):
            cloud = self.prepare(
                merged.points,
                merged.normals if iteration else raw,
                plan=plan,
                iteration=iteration,
                frame=frame,
                initial="input" if iteration else initial,
                seed=iteration_seed(seed, iteration),
                should_stop=should_stop,
                survey=survey,
                oriented=normals is not None,
            )

            def step(done: int, before: int = iteration * len(given)) -> None:
                if progress is not None:
                    progress(before + done, total)

            flagged = merged.flagged
            merged = denoise_tiles(cloud, partial(self.denoise_tile, should_stop=should_stop), progress=step)
            merged = replace(merged, flagged=flagged | merged.flagged)
        found = diagnose(given, merged.points, cloud.noise(plan))
        metadata = self.metadata(seed=seed, plan=plan, initial=initial) | found.metadata()
        return DenoiseResult(merged.points, merged.normals, merged.flagged, metadata, found)

    def metadata(self, *, seed: int, plan: Plan, initial: InitialNormals) -> dict[str, str]:
        """Return what is needed to repeat a run, for the result's file."""
        return {
            "model": self.info.name if self.info else self.inference.kind,
            "weights_sha256": self.info.sha256 if self.info else "",
            "version": __version__,
            "device": self.device,
            "precision": self.precision,
            "seed": str(seed),
            "normals": initial,
            **plan.metadata(),
        }
