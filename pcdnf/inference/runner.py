"""A network at work on one device: batches of patches in, denoised points and normals out.

Every batch has the same shape (the last one is filled up), so a point's result does not depend on who is in the batch
with it.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from ..geometry.normals import unit_towards
from ..geometry.patches import Patches, PatchSource
from ..geometry.patches_cuda import DevicePatches, DevicePatchSource
from ..geometry.patches_local import LocalPatchSource
from ..models.cpu.allocator import keep_freed_memory
from ..models.cpu.folded import fold
from ..models.cpu.folded_lite import FoldedLite
from ..models.lite import LiteOutput, PCDNFLite
from ..models.pcdnf import PCDNF, NetworkOutput
from .device import DeviceError, room_for
from .results import TileResult

log = logging.getLogger(__name__)

BATCH = {"pcdnf": 32, "lite": 512}
"""Patches a batch on the CPU: chunks of them for some threads."""
CUDA_BATCH = {"pcdnf": 512, "lite": 8192}
CUDA_PATCH_BYTES = {"pcdnf": 6 << 20, "lite": 1 << 20}
"""Generous, of a patch and all that is made of it: a batch takes at most half of the memory that is free."""
SMALLEST_BATCH = 8
"""Less is not tried where a device runs out of memory."""
FEWEST_NEIGHBOURS = 6
"""A point with fewer neighbours inside the patch is returned as it came, flagged: a quadric has six terms."""
LONGEST_STEP = 1.0
"""Displacements end at the patch's border, in patch radii."""

ShouldStop = Callable[[], bool]


class StoppedError(Exception):
    """The caller's ``should_stop`` said so."""


Stopped = StoppedError
"""The older name."""


def batch_for(kind: str, device: str) -> int:
    """Patches a batch: on a GPU as many as suit its free memory, a power of two."""
    if device == "cpu":
        return BATCH[kind]
    free, _ = torch.cuda.mem_get_info(device)
    fitting = max(SMALLEST_BATCH, free // 2 // CUDA_PATCH_BYTES[kind])
    return min(CUDA_BATCH[kind], 1 << (fitting.bit_length() - 1))


class Inference:
    """One network on one device.

    Parameters
    ----------
    network : nn.Module
        ``PCDNF`` or ``PCDNFLite``; switched to inference.
    device, precision : str
        "cpu" or "cuda:N"; "float32" or "bfloat16".

    Raises
    ------
    DeviceError
        ``out_of_memory``.
    """

    def __init__(self, network: nn.Module, *, device: str = "cpu", precision: str = "float32") -> None:
        self.device, self.precision = device, precision
        self.kind = "pcdnf" if isinstance(network, PCDNF) else "lite"
        self.batch = batch_for(self.kind, device)
        dtype = torch.bfloat16 if precision == "bfloat16" else torch.float32
        if device == "cpu":
            keep_freed_memory()
        network.eval()
        with room_for("the network"):
            network = network.to(device)
            if isinstance(network, PCDNF):
                network = fold(network, dtype)
            elif isinstance(network, PCDNFLite) and device == "cpu":
                network = FoldedLite(network, dtype)
        self._network = network
        self._autocast = isinstance(network, PCDNFLite) and dtype is torch.bfloat16

    @property
    def batch(self) -> int:
        """Patches a batch; set by the caller, or the device's own, and halved where the memory asks for it."""
        return self._batch

    @batch.setter
    def batch(self, value: int) -> None:
        self._batch = self._whole_batch = value

    def restore_batch(self) -> None:
        """Try the whole batch again: the memory may have been short for a moment."""
        self._batch = self._whole_batch

    @torch.inference_mode()
    def network(self, points: Tensor, normals: Tensor) -> NetworkOutput | LiteOutput:
        """Run the network on patches in their frames.

        Parameters
        ----------
        points, normals : Tensor, (B, M, 3) float32
            In patch radii, the centre first and at the origin; see :mod:`pcdnf.geometry.patches`.

        Returns
        -------
        object
            ``displacement`` (B, 3), ``normal`` (B, 3), ``weight`` (B, M), ``selected`` (B, K).
        """
        with torch.autocast(torch.device(self.device).type, torch.bfloat16, enabled=self._autocast):
            output: NetworkOutput | LiteOutput = self._network(points.to(self.device), normals.to(self.device))
        return output

    def denoise(
        self,
        points: NDArray[np.float64],
        raw: NDArray[np.float32],
        source: PatchSource | LocalPatchSource | DevicePatchSource,
        centres: NDArray[np.int64],
        *,
        unit: float = 1.0,
        progress: Callable[[int], None] | None = None,
        should_stop: ShouldStop | None = None,
    ) -> TileResult:
        """Denoise some points of a cloud; where the device runs out of memory, go on with half the batch.

        Parameters
        ----------
        points : ndarray, (N, 3) float64
            The cloud, in its own unit.
        raw : ndarray, (N, 3) float32
            Its raw normals.
        source : PatchSource, LocalPatchSource or DevicePatchSource
            Of the cloud.
        centres : ndarray, (n,) int64
            Rows to denoise.
        unit : float
            The source's unit in that of ``points``.
        progress, should_stop : callable, optional
            See :meth:`pcdnf.denoiser.Denoiser.denoise_tile`.

        Raises
        ------
        DeviceError
            ``out_of_memory``, when the smallest batch does not fit either.
        StoppedError
        """
        parts: list[list[Tensor]] = []
        done = 0
        while done < len(centres):
            if should_stop is not None and should_stop():
                raise StoppedError
            batch = self.batch  # another thread may prepare a cloud meanwhile
            chosen = centres[done : done + batch]
            filled = np.concatenate([chosen, np.full(batch - len(chosen), chosen[0])])
            try:
                with room_for(f"{batch} neighbourhoods a batch"):
                    parts.append([each[: len(chosen)] for each in self._work(source.take(filled))])
            except DeviceError:
                if batch <= SMALLEST_BATCH:
                    raise
                self._halve(batch)
                continue
            done += len(chosen)
            if progress is not None:
                progress(done)
        with room_for("a tile's results"):
            move, normal, neighbours = (torch.cat(each).cpu().numpy() for each in zip(*parts, strict=True))
        before = raw[centres]
        lost = (neighbours <= FEWEST_NEIGHBOURS) | ~np.isfinite(move + normal).all(1)
        length = np.linalg.norm(move, axis=1, keepdims=True)
        move *= LONGEST_STEP / np.maximum(length, LONGEST_STEP)
        moved = points[centres] + np.where(lost[:, None], 0.0, move) * (source.radii(centres)[:, None] * unit)
        return TileResult(moved, unit_towards(np.where(lost[:, None], before, normal), before), lost)

    def _work(self, patches: Patches | DevicePatches) -> tuple[Tensor, Tensor, Tensor]:
        """Displacement in patch radii and normal (B, 3) in the world, float64, and the neighbours there are (B,)."""
        points, normals, frames, index = (
            torch.as_tensor(each) for each in (patches.points, patches.normals, patches.frames, patches.index)
        )
        output = self.network(points, normals)
        turn = frames.to(self.device).double()
        move, normal = ((each.double()[..., None] * turn).sum(1) for each in (output.displacement, output.normal))
        return move, normal, (index >= 0).sum(1)

    def _halve(self, batch: int) -> None:
        torch.cuda.empty_cache()
        self._batch = batch // 2
        log.warning("device out of memory: now %d neighbourhoods a batch", batch // 2)
