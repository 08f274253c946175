"""Cloud in, cloud out: frames, tiles, batches and iterations around a network.

A cloud is centred and scaled by its bounding-box diagonal in float64; only differences inside a patch become
float32. A tile is a range of points along a space-filling curve. Every batch has the same shape (the last one is
filled up), a patch's frame is computed patch by patch, and random subsets depend on (seed, index) alone, so a
point's result does not depend on tiles, batches or workers.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor, nn

from . import __version__
from .checkpoint import DEFAULT_MODEL, ModelInfo, load_checkpoint
from .cloud import Cloud, CloudError, Frame, TileResult
from .device import choose_device, choose_precision
from .folded import fold
from .frames import to_world
from .lite import LiteOutput
from .memory import keep_freed_memory
from .models import build_network
from .network import PCDNF, NetworkOutput
from .normals import raw_normals, unit_towards
from .patches import Patches, PatchSource, Recipe

BATCH = {"pcdnf": 32, "lite": 256}
"""Patches a batch on the CPU: temporaries stay in cache."""
CUDA_BATCH = {"pcdnf": 256, "lite": 8192}
FEWEST_NEIGHBOURS = 6
"""A point with fewer neighbours inside the patch is returned as it came, flagged: a quadric has six terms."""
LONGEST_STEP = 1.0
"""Displacements end at the patch's border, in patch radii."""

__all__ = ["Cloud", "CloudError", "DenoiseResult", "Denoiser", "Frame", "Stopped", "TileResult", "iteration_seed"]

Progress = Callable[[int, int], None]
ShouldStop = Callable[[], bool]


class Stopped(Exception):
    """The caller's ``should_stop`` said so."""


@dataclass(frozen=True)
class DenoiseResult:
    """A denoised cloud, in the order of the input.

    Attributes
    ----------
    points : ndarray, (N, 3) float64
    normals : ndarray, (N, 3) float32
        Unit length, on the side of the input's normal where there was one.
    flagged : ndarray, (N,) bool
        Points without enough neighbours, returned as they came.
    metadata : dict of str
        Model, weights' hash, device, precision, seed, iterations, version: enough to repeat the run.
    """

    points: NDArray[np.float64]
    normals: NDArray[np.float32]
    flagged: NDArray[np.bool_]
    metadata: dict[str, str] = field(default_factory=dict)


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
        self.kind = "pcdnf" if isinstance(network, PCDNF) else "lite"
        self.batch = (BATCH if device == "cpu" else CUDA_BATCH)[self.kind]
        dtype = torch.bfloat16 if precision == "bfloat16" else torch.float32
        if device == "cpu":
            keep_freed_memory()
        network.eval()
        self._network = fold(network.to(device), dtype) if isinstance(network, PCDNF) else network.to(device)
        self._autocast = self.kind == "lite" and dtype is torch.bfloat16
        self.minimum_points = FEWEST_NEIGHBOURS + 10

    @classmethod
    def load(
        cls, name_or_path: str | os.PathLike[str] = DEFAULT_MODEL, *, device: str = "auto", precision: str = "auto"
    ) -> Denoiser:
        """A denoiser with a shipped model (by name) or a checkpoint (by path).

        Parameters
        ----------
        name_or_path : str or path
        device : str
            "auto" takes the first GPU, else the CPU; or "cpu", "cuda", "cuda:N".
        precision : {"auto", "float32", "bfloat16"}
            "auto" takes bfloat16 where the device computes it natively and the network gains by it.

        Raises
        ------
        CheckpointError
            No such model, or a damaged one.
        DeviceError
            No such device, or a precision it does not have.
        """
        info, state = load_checkpoint(name_or_path)
        device = choose_device(device)
        precision = choose_precision(precision, device=device, kind=info.kind)
        network = build_network(info.kind, info.config)
        network.load_state_dict(state)
        return cls(network, Recipe(**info.recipe), info=info, device=device, precision=precision)

    @torch.inference_mode()
    def network(self, points: Tensor, normals: Tensor) -> NetworkOutput | LiteOutput:
        """Run the network on patches in their frames.

        Parameters
        ----------
        points, normals : Tensor, (B, M, 3) float32
            In patch radii, the centre first and at the origin; see :mod:`pcdnf.patches`.

        Returns
        -------
        object
            ``displacement`` (B, 3), ``normal`` (B, 3), ``weight`` (B, M), ``selected`` (B, K).
        """
        with torch.autocast(torch.device(self.device).type, torch.bfloat16, enabled=self._autocast):
            output: NetworkOutput | LiteOutput = self._network(points.to(self.device), normals.to(self.device))
        return output

    def warm_up(self) -> None:
        """Compile and touch everything on one small cloud."""
        grid = np.stack(np.meshgrid(np.arange(20.0), np.arange(20.0)), -1).reshape(-1, 2)
        self.denoise(np.c_[grid, 0.1 * np.random.default_rng(0).normal(size=len(grid))])

    def prepare(
        self,
        points: NDArray[np.floating],
        normals: NDArray[np.floating] | None = None,
        *,
        frame: Frame | None = None,
        seed: int = 0,
        should_stop: ShouldStop | None = None,
    ) -> Cloud:
        """Search structures, spatial order and raw normals of a cloud, for one iteration.

        Parameters
        ----------
        points : ndarray, (N, 3) float
        normals : ndarray, (N, 3) float, optional
            Raw normals of any length; PCA normals where not given or zero.
        frame : Frame, optional
            The first iteration's; later ones keep its centre and scale.
        seed : int
            Of the random subsets, see :func:`iteration_seed`.
        should_stop : callable, optional

        Raises
        ------
        CloudError
            Too few points, no extent, or one out of range, NaN or infinity.
        Stopped
        """
        given: NDArray[np.float64] = np.ascontiguousarray(points, np.float64)
        if len(given) < self.minimum_points:
            raise CloudError(
                f"The cloud has {len(given)} points; the network needs at least {self.minimum_points}.",
                code="too_few_points",
                hint="Send a denser or larger piece of the scan.",
            )
        frame = Frame.of(given) if frame is None else frame
        local = frame.to_local(given)
        tree = cKDTree(local)

        def check() -> None:
            if should_stop is not None and should_stop():
                raise Stopped

        raw = raw_normals(local, normals, tree=tree, check=check)
        source = PatchSource(local, raw, self.recipe, diagonal=1.0, seed=seed, tree=tree)
        return Cloud(given, raw, frame, source)

    def denoise_tile(
        self,
        cloud: Cloud,
        start: int,
        stop: int,
        *,
        progress: Callable[[int], None] | None = None,
        should_stop: ShouldStop | None = None,
    ) -> TileResult:
        """Denoise the points ``cloud.order[start:stop]``.

        ``progress`` is called with the points of the tile done so far, ``should_stop`` between batches.

        Raises
        ------
        Stopped
        """
        centres = cloud.order[start:stop]
        moves = np.empty((len(centres), 3))
        normals = np.empty((len(centres), 3), np.float32)
        flagged = np.empty(len(centres), bool)
        for low, patches in self._batches(cloud.source, centres):
            if should_stop is not None and should_stop():
                raise Stopped
            high = min(low + self.batch, len(centres))
            index = patches.index[: high - low]
            output = self.network(torch.from_numpy(patches.points), torch.from_numpy(patches.normals))
            move, normal = (
                to_world(local.float().cpu().numpy(), patches.frames)[: high - low]
                for local in (output.displacement, output.normal)
            )
            raw = cloud.normals[index[:, 0]]
            lost = ((index >= 0).sum(1) <= FEWEST_NEIGHBOURS) | ~np.isfinite(move + normal).all(1)
            length = np.linalg.norm(move, axis=1, keepdims=True)
            move *= np.minimum(1.0, LONGEST_STEP / np.maximum(length, LONGEST_STEP))
            moves[low:high] = np.where(lost[:, None], 0.0, move) * (cloud.source.radius * cloud.frame.diagonal)
            normals[low:high] = unit_towards(np.where(lost[:, None], raw, normal), raw)
            flagged[low:high] = lost
            if progress is not None:
                progress(high)
        return TileResult(cloud.points[centres] + moves, normals, flagged)

    def _batches(self, source: PatchSource, centres: NDArray[np.int64]) -> Iterator[tuple[int, Patches]]:
        """Batches of one shape; the last is filled up with its own first centre."""
        for low in range(0, len(centres), self.batch):
            chosen = centres[low : low + self.batch]
            filled = np.concatenate([chosen, np.full(self.batch - len(chosen), chosen[0])])
            yield low, source.take(filled)

    def denoise(
        self,
        points: NDArray[np.floating],
        normals: NDArray[np.floating] | None = None,
        *,
        iterations: int = 1,
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
            Raw normals; by PCA where not given.
        iterations : int
            Each takes points and normals of the one before.
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
        Stopped
            ``should_stop`` returned True.
        """
        given: NDArray[np.float64] = np.ascontiguousarray(points, np.float64)
        frame = Frame.of(given)
        current, raw = given, normals
        moved, turned = given, np.empty(given.shape, np.float32)
        flagged = np.zeros(len(given), bool)
        total = iterations * len(given)
        for iteration in range(iterations):
            cloud = self.prepare(
                current, raw, frame=frame, seed=iteration_seed(seed, iteration), should_stop=should_stop
            )
            moved, turned = np.empty_like(given), np.empty(given.shape, np.float32)
            for start, stop in cloud.tiles():
                before = iteration * len(given) + start

                def step(done: int, before: int = before) -> None:
                    if progress is not None:
                        progress(before + done, total)

                tile = self.denoise_tile(cloud, start, stop, progress=step, should_stop=should_stop)
                rows = cloud.order[start:stop]
                moved[rows], turned[rows] = tile.points, tile.normals
                flagged[rows] |= tile.flagged
            current, raw = moved, turned
        return DenoiseResult(moved, turned, flagged, self.metadata(seed=seed, iterations=iterations))

    def metadata(self, *, seed: int, iterations: int) -> dict[str, str]:
        """What is needed to repeat a run, for the result's file."""
        return {
            "model": self.info.name if self.info else self.kind,
            "weights_sha256": self.info.sha256 if self.info else "",
            "version": __version__,
            "device": self.device,
            "precision": self.precision,
            "iterations": str(iterations),
            "seed": str(seed),
        }


def iteration_seed(seed: int, iteration: int) -> int:
    """Seed of one iteration's random subsets."""
    return seed + iteration
