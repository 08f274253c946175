"""Patches taken on the device: ball queries as in ``ball_grid`` and frames as in ``frames``, in torch.

The same cells, nine contiguous runs of points around a query, and a random subset of what lies in the ball. The subset
is that of the lowest hashes of (seed, index of the centre, index of the neighbour): a point's neighbours depend on
nothing else, though they are others than the CPU's where a ball holds more points than a patch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from .ball_grid import BallGrid
from .frames import local_patches_torch
from .patches import PatchSource
from .patches_local import LocalPatchSource
from .sheets import without_other_sheets_torch

CANDIDATES = 1 << 25
"""Candidates of neighbours that are weighed at a time; each takes some 40 bytes."""
NOBODY = torch.iinfo(torch.int64).max


@dataclass(frozen=True)
class DevicePatches:
    """A batch of patches in their own frames; see :class:`pcdnf.geometry.patches.Patches`.

    Attributes
    ----------
    points, normals : Tensor, (B, M, 3) float32
    frames : Tensor, (B, 3, 3) float32
    index : Tensor, (B, M) int64
    """

    points: Tensor
    normals: Tensor
    frames: Tensor
    index: Tensor


class DeviceGrid:
    """A :class:`~pcdnf.geometry.ball_grid.BallGrid` on a device."""

    def __init__(self, grid: BallGrid, device: str) -> None:
        self.cell, self.dims = grid.radius, grid.dims.tolist()
        self.origin, self.order, self.keys, self.starts, self.points = (
            torch.from_numpy(each).to(device) for each in (grid.origin, grid.order, grid.keys, grid.starts, grid.points)
        )

    def runs(self, at: Tensor) -> tuple[Tensor, Tensor]:
        """First point and length (B, 9) of the runs of sorted points that hold the 27 cells around places (B, 3)."""
        across, along, up = self.dims
        cell = ((at - self.origin) / self.cell).floor().long()  # (B, 3)
        step = torch.tensor([-1, 0, 1], device=at.device)
        x = (cell[:, :1] + step).repeat_interleave(3, 1)  # (B, 9)
        y = (cell[:, 1:2] + step).repeat(1, 3)
        row = (x * along + y) * up
        low = row + (cell[:, 2:] - 1).clamp(min=0)
        high = row + (cell[:, 2:] + 2).clamp(max=up)
        first = self.starts[torch.searchsorted(self.keys, low)]
        last = self.starts[torch.searchsorted(self.keys, high)]
        inside = (x >= 0) & (x < across) & (y >= 0) & (y < along)
        return first, torch.where(inside, last - first, 0)


class DevicePatchSource:
    """Takes patches of kind "ball" from one cloud.

    Parameters
    ----------
    source : PatchSource or LocalPatchSource
        Of the cloud; its grids are copied to the device.
    device : str
    """

    def __init__(self, source: PatchSource | LocalPatchSource, *, device: str) -> None:
        self.recipe, self.radius, self.device, self._seed = source.recipe, source.radius, device, source.seed
        self._points, self._normals = (torch.from_numpy(each).to(device) for each in (source.points, source.normals))
        if isinstance(source, LocalPatchSource):
            self._grids = {step: DeviceGrid(grid, device) for step, grid in source.grids.grids.items()}
            self._step = torch.from_numpy(source.grids.step).to(device)
            self._noise: Tensor | None = torch.from_numpy(source.noise).to(device)
            self._radius = torch.from_numpy(source.radius).to(device)
            self._sided = source.sided
        else:
            assert source.grid is not None
            self._grids = {0: DeviceGrid(source.grid, device)}
            self._step = torch.zeros(len(source.points), dtype=torch.int64, device=device)
            self._noise, self._sided = None, False
            self._radius = torch.full((len(source.points),), source.radius, dtype=torch.float64, device=device)

    def take(self, centres: NDArray[np.int64]) -> DevicePatches:
        """Patches of the points ``centres`` (B,), in their frames."""
        own = torch.from_numpy(centres).to(self.device)
        index = self.neighbours(own)
        if self._noise is not None:
            index = without_other_sheets_torch(self._points, self._normals, index, self._noise, sided=self._sided)
        points, normals, frames = local_patches_torch(
            self._points, self._normals, index, self._radius[own], upward=self.recipe.upward
        )
        return DevicePatches(points, normals, frames, index)

    def radii(self, centres: NDArray[np.int64]) -> NDArray[np.float64]:
        """Patch radius of the points ``centres`` (B,)."""
        radius: NDArray[np.float64] = self._radius[torch.from_numpy(centres).to(self.device)].cpu().numpy()
        return radius

    def neighbours(self, own: Tensor) -> Tensor:
        """Neighbours (B, M) int64 of the points ``own`` (B,), the centre first, -1 for padding."""
        out = torch.empty((len(own), self.recipe.points), dtype=torch.int64, device=self.device)
        steps = self._step[own]
        for step, grid in self._grids.items():
            at = (
                torch.nonzero(steps == step)[:, 0]
                if len(self._grids) > 1
                else torch.arange(len(own), device=self.device)
            )
            if len(at):
                out[at] = self._on_grid(own[at], grid)
        return out

    def _on_grid(self, own: Tensor, grid: DeviceGrid) -> Tensor:
        """Neighbours (B, M) of points whose balls are found on one grid."""
        first, count = grid.runs(self._points[own])  # (B, 9)
        widest = int(count.sum(1).amax())
        rows = max(1, CANDIDATES // max(widest, 1))
        parts = [
            self._subset(grid, own[low : low + rows], first[low : low + rows], count[low : low + rows])
            for low in range(0, len(own), rows)
        ]
        return torch.cat([own[:, None], torch.cat(parts)], 1)

    def _subset(self, grid: DeviceGrid, own: Tensor, first: Tensor, count: Tensor) -> Tensor:
        """Draw the patch's random subset of each ball, without the centre: (B, M - 1) int64, -1 for padding."""
        wanted = self.recipe.points - 1
        ends = count.cumsum(1)  # (B, 9)
        place = torch.arange(max(int(ends[:, -1].amax()), wanted), device=self.device).expand(len(own), -1).contiguous()
        run = torch.searchsorted(ends, place, right=True).clamp(max=8)  # (B, T)
        sorted_place = (first - ends + count).gather(1, run) + place
        sorted_place = sorted_place.clamp(max=len(grid.order) - 1)
        candidate = grid.order[sorted_place]  # (B, T)
        square = (grid.points[sorted_place] - self._points[own][:, None]).square().sum(-1)
        in_ball = (place < ends[:, -1:]) & (square <= self._radius[own][:, None] ** 2) & (candidate != own[:, None])
        seed = _signed(self._seed & 0xFFFFFFFFFFFFFFFF)
        key = (_mix(_mix(own + seed)[:, None] ^ candidate) << 32) | candidate  # the lower index of equal hashes
        key, chosen = torch.where(in_ball, key & NOBODY, NOBODY).topk(wanted, dim=1, largest=False)
        return torch.where(key == NOBODY, -1, candidate.gather(1, chosen))


def _mix(x: Tensor) -> Tensor:
    """One step of splitmix64 on int64, which wraps around like uint64; its shifts fill with the sign."""
    x = x + _signed(0x9E3779B97F4A7C15)
    x = (x ^ ((x >> 30) & 0x3FFFFFFFF)) * _signed(0xBF58476D1CE4E5B9)
    x = (x ^ ((x >> 27) & 0x1FFFFFFFFF)) * _signed(0x94D049BB133111EB)
    return x ^ ((x >> 31) & 0x1FFFFFFFF)


def _signed(x: int) -> int:
    return x - (1 << 64) if x >= 1 << 63 else x
