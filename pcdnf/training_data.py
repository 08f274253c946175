"""Training batches without end: shapes are made, made noisy, cut into patches, and replaced by fresh ones.

A pool of clouds lives in memory with its trees. A share of them is taken through a first pass of a denoiser
(in a crop, to keep it cheap), so that a network also sees what its own second iteration will see.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from dataclasses import dataclass

import numba
import numpy as np
import torch
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from .losses import Surface
from .normals import pca_normals
from .patches import PatchSource, Recipe
from .shapes import random_shape

SURFACE_POINTS = 96
"""Clean points around each centre that the losses see."""
CROP = 4.0
"""Radius of a first pass's crop in patch radii; centres are taken from the inner half."""

FirstPass = Callable[[NDArray[np.float64], NDArray[np.float32], int], tuple[NDArray[np.float64], NDArray[np.float32]]]
"""(points, raw normals, seed) of a crop with diagonal-1 coordinates to denoised points and normals."""


@dataclass(frozen=True)
class Batch:
    """Patches with their supervision; all tensors float32 in the patch frames.

    Attributes
    ----------
    points, normals : Tensor, (B, M, 3)
    surface : Surface
        (B, S, 3), clean.
    clean_points, clean_normals : Tensor, (B, M, 3)
        Counterparts of the patch's points.
    """

    points: Tensor
    normals: Tensor
    surface: Surface
    clean_points: Tensor
    clean_normals: Tensor


class TrainingCloud:
    """A clean cloud, its noisy version and what is needed to cut patches from it."""

    def __init__(self, rng: Generator, recipe: Recipe, first_pass: FirstPass | None) -> None:
        count = int(rng.uniform(50_000, 100_000) if rng.random() < 0.6 else np.exp(rng.uniform(*np.log([8e3, 2e5]))))
        shape = random_shape(rng, count)
        clean, clean_normals = shape.points, shape.normals
        if rng.random() < 0.15:  # uneven sampling: density falls along a random direction
            position = clean @ rng.normal(size=3)
            keep = rng.random(count) < np.clip((position - position.min()) / np.ptp(position), 0.15, 1)
            clean, clean_normals = clean[keep], clean_normals[keep]
        noisy = clean + _noise(rng, clean.shape)
        normals = pca_normals(noisy, workers=1)
        self.centres = np.arange(len(noisy))
        if first_pass is not None:
            reach = CROP * recipe.radius
            middle = noisy[rng.integers(len(noisy))]
            crop = np.flatnonzero(((noisy - middle) ** 2).sum(1) < reach**2)
            clean, clean_normals = clean[crop], clean_normals[crop]
            noisy, normals = first_pass(noisy[crop], normals[crop], int(rng.integers(1 << 31)))
            self.centres = np.flatnonzero(((noisy - middle) ** 2).sum(1) < (reach / 2) ** 2)
        self.clean, self.clean_normals = clean.astype(np.float32), clean_normals.astype(np.float32)
        self._clean_tree = cKDTree(clean)
        self._edges = self.centres[self._near_edge(self.centres)]
        self._source = PatchSource(noisy, normals, recipe, diagonal=1.0, seed=0, workers=1)
        self.noisy = noisy

    def _near_edge(self, index: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Where the clean normals turn by more than 25 degrees within 16 neighbours."""
        if len(self.clean) < 16:
            return np.zeros(len(index), bool)
        _, around = self._clean_tree.query(self.clean[index], 16)
        cosine = (self.clean_normals[around] * self.clean_normals[index, None]).sum(-1)
        near: NDArray[np.bool_] = cosine.min(1) < np.cos(np.radians(25))
        return near

    def batch(self, rng: Generator, count: int, edges: float) -> list[NDArray[np.float32]]:
        """Arrays of a :class:`Batch` of ``count`` patches, a share ``edges`` of them centred near sharp edges."""
        centres = rng.choice(self.centres, count)
        if len(self._edges):
            chosen = rng.random(count) < edges
            centres[chosen] = rng.choice(self._edges, int(chosen.sum()))
        patches = self._source.take(centres, seed=int(rng.integers(1 << 31)), spin=_spins(rng, count))
        at, turn = self.noisy[centres], patches.frames.transpose(0, 2, 1)
        _, around = self._clean_tree.query(at, min(SURFACE_POINTS, len(self.clean)))
        if around.shape[1] < SURFACE_POINTS:
            around = np.resize(around.T, (SURFACE_POINTS, count)).T
        own = np.where(patches.index < 0, patches.index[:, :1], patches.index)
        result = [patches.points, patches.normals]
        for index in (around, own):
            local = (self.clean[index] - at[:, None]).astype(np.float32) / np.float32(self._source.radius)
            result += [local @ turn, self.clean_normals[index] @ turn]
        return result


def _noise(rng: Generator, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Noise of a random kind and level, 0 to 3 % of the diagonal (1)."""
    level = rng.uniform(0, 0.002) if rng.random() < 0.08 else np.exp(rng.uniform(*np.log([0.002, 0.03])))
    kind = rng.random()
    if kind < 0.8:
        return level * rng.normal(size=shape)
    if kind < 0.87:
        return level * rng.laplace(scale=np.sqrt(0.5), size=shape)
    if kind < 0.94:
        return level * rng.uniform(-np.sqrt(3), np.sqrt(3), size=shape)
    return level * rng.normal(size=shape) * rng.uniform(0.2, 1.5, 3)


def _spins(rng: Generator, count: int) -> NDArray[np.float64]:
    """Random rotations about z and reflections (B, 3, 3): the signs of a PCA frame are arbitrary."""
    angle = rng.uniform(0, 2 * np.pi, count)
    flip, up = rng.choice([-1.0, 1.0], (2, count))
    spin = np.zeros((count, 3, 3))
    spin[:, 0, 0], spin[:, 0, 1] = np.cos(angle), -np.sin(angle) * flip
    spin[:, 1, 0], spin[:, 1, 1] = np.sin(angle), np.cos(angle) * flip
    spin[:, 2, 2] = up
    return spin


class BatchStream:
    """Batches from a thread of its own, which never lets the training wait once the pool is filled.

    Parameters
    ----------
    recipe : Recipe
    seed : int
    batch, clouds_a_batch : int
    pool : int
        Clouds held at once.
    fresh_every : int
        Batches after which one cloud of the pool is replaced.
    edges : float
        Share of patches centred near sharp edges.
    """

    def __init__(
        self,
        recipe: Recipe,
        *,
        seed: int,
        batch: int,
        clouds_a_batch: int = 4,
        pool: int = 64,
        fresh_every: int,
        edges: float = 0.25,
    ) -> None:
        self._recipe, self._rng = recipe, np.random.default_rng(seed)
        self._batch, self._clouds_a_batch = batch, clouds_a_batch
        self._pool, self._fresh_every, self._edges = pool, fresh_every, edges
        self._ready: queue.Queue[Batch | BaseException] = queue.Queue(6)
        self.first_pass: FirstPass | None = None
        self.first_pass_share = 0.0
        threading.Thread(target=self._run, daemon=True).start()

    def get(self) -> Batch:
        """The next batch; raises what stopped the thread."""
        item = self._ready.get()
        if isinstance(item, BaseException):
            raise item
        return item

    def _cloud(self) -> TrainingCloud:
        use = self.first_pass if self._rng.random() < self.first_pass_share else None
        while True:
            cloud = TrainingCloud(self._rng, self._recipe, use)
            if len(cloud.centres) >= 64:
                return cloud

    def _run(self) -> None:
        try:
            numba.set_num_threads(1)
            clouds = [self._cloud() for _ in range(min(8, self._pool))]
            made = 0
            while True:
                made += 1
                if len(clouds) < self._pool and made % 4 == 0:
                    clouds.append(self._cloud())
                elif made % self._fresh_every == 0:
                    clouds[int(self._rng.integers(len(clouds)))] = self._cloud()
                self._ready.put(sample_batch(clouds, self._rng, self._batch, self._clouds_a_batch, self._edges))
        except BaseException as error:
            self._ready.put(error)


def sample_batch(clouds: list[TrainingCloud], rng: Generator, size: int, clouds_a_batch: int, edges: float) -> Batch:
    """A batch of ``size`` patches from ``clouds_a_batch`` random clouds."""
    parts = [
        clouds[int(rng.integers(len(clouds)))].batch(rng, size // clouds_a_batch, edges) for _ in range(clouds_a_batch)
    ]
    points, normals, near, near_normals, clean, clean_normals = (
        torch.from_numpy(np.concatenate(arrays).astype(np.float32, copy=False)) for arrays in zip(*parts, strict=True)
    )
    return Batch(points, normals, Surface(near, near_normals), clean, clean_normals)
