"""Training batches without end, from processes of their own, so that the training never waits for them."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numba
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.utils.data import DataLoader, IterableDataset, get_worker_info

from ..denoiser import Denoiser
from ..geometry.patches import PatchSource
from ..geometry.recipe import Recipe
from ..models.cpu.allocator import keep_freed_memory
from ..scanners.catalog import KINDS
from .dataset import FirstPass, Sample, TrainingCloud, sample_batch, scan_samples, shape_sample
from .losses import Batch

CLOUDS_A_BATCH = 4
EDGES = 0.25
"""Share of the patches centred near sharp edges."""
FIRST_CLOUDS = 4
"""A process begins with these; its pool grows by one every ``GROW`` batches."""
GROW = 6
FEWEST_CENTRES = 16
"""A cloud with fewer is not worth its place."""
CROPS_A_SCAN = 12
SCAN_SEEDS = 900_000
"""Scans to train on have seeds below this."""


@dataclass(frozen=True)
class Teacher:
    """The denoiser whose first pass prepares a share of the clouds.

    Attributes
    ----------
    network : nn.Module
        In shared memory, so that every process sees its present weights.
    recipe : Recipe
    ready : Tensor, (1,)
        In shared memory; not zero once the network is worth using.
    share : float
        Of the clouds.
    """

    network: nn.Module
    recipe: Recipe
    ready: Tensor
    share: float


THREAD_VARIABLES = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class TrainingBatches(IterableDataset[Batch]):
    """Batches of patches from a pool of clouds, which are replaced by fresh ones one by one.

    Parameters
    ----------
    recipe : Recipe
    seed : int
    batch : int
        Patches a batch.
    pool : int
        Clouds held at once, over all processes.
    fresh_every : int
        Batches after which a process replaces one of its clouds.
    teacher : Teacher, optional
    scans : float
        Share of the clouds that are crops of simulated scans; the others are shapes.
    """

    def __init__(
        self,
        recipe: Recipe,
        *,
        seed: int,
        batch: int,
        pool: int,
        fresh_every: int,
        teacher: Teacher | None,
        scans: float = 0.0,
    ) -> None:
        self._recipe, self._seed, self._batch = recipe, seed, batch
        self._pool, self._fresh_every, self._teacher = pool, fresh_every, teacher
        self._scans = scans
        self._crops: list[Sample] = []

    def __iter__(self) -> Iterator[Batch]:
        worker = get_worker_info()
        number, processes = (0, 1) if worker is None else (worker.id, worker.num_workers)
        if worker is not None:
            keep_freed_memory()
            numba.set_num_threads(1)
            torch.set_num_threads(1)
        rng = np.random.default_rng((self._seed, number))
        pool = max(FIRST_CLOUDS, self._pool // processes)
        clouds = [self._cloud(rng) for _ in range(min(FIRST_CLOUDS, self._pool))]
        made = 0
        while True:
            made += 1
            if len(clouds) < pool and made % GROW == 0:
                clouds.append(self._cloud(rng))
            elif made % self._fresh_every == 0:
                clouds[int(rng.integers(len(clouds)))] = self._cloud(rng)
            yield sample_batch(clouds, rng, self._batch, CLOUDS_A_BATCH, EDGES)

    def _cloud(self, rng: np.random.Generator) -> TrainingCloud:
        ahead = self._teacher
        use = None
        if ahead is not None and ahead.ready.item() and rng.random() < ahead.share:
            use = first_pass(Denoiser(ahead.network, ahead.recipe))
        while True:
            sample = self._crop(rng) if rng.random() < self._scans else shape_sample(rng)
            cloud = TrainingCloud(rng, sample, self._recipe, use)
            if len(cloud.centres) >= FEWEST_CENTRES:
                return cloud

    def _crop(self, rng: np.random.Generator) -> Sample:
        """Return a crop of the current scan, or of a new one after its last crop."""
        while not self._crops:
            kind = str(rng.choice(list(KINDS)))
            self._crops = scan_samples(rng, kind, int(rng.integers(SCAN_SEEDS)), CROPS_A_SCAN)
        return self._crops.pop()


def stream(batches: TrainingBatches, *, processes: int, pin: bool) -> Iterator[Batch]:
    """Return the batches, made by so many processes; by this process if the number is 0.

    ``pin`` puts them into memory that a GPU reads by itself.
    """
    if not processes:
        return iter(batches)
    context: Any = "spawn"  # a fork would inherit OpenMP's threads, which do not survive it
    loader = DataLoader(
        batches, batch_size=None, num_workers=processes, multiprocessing_context=context, pin_memory=pin
    )
    with _one_thread():
        return iter(loader)  # starts the processes


@contextmanager
def _one_thread() -> Iterator[None]:
    """Let processes that start meanwhile have one thread. Numba refuses a number that changes, so it is put back."""
    absent = [name for name in THREAD_VARIABLES if name not in os.environ]
    os.environ.update(dict.fromkeys(absent, "1"))
    try:
        yield
    finally:
        for name in absent:
            del os.environ[name]


def first_pass(denoiser: Denoiser) -> FirstPass:
    """One iteration of a crop whose cloud has diagonal 1, as the second iteration will see it."""

    def apply(
        points: NDArray[np.float64],
        normals: NDArray[np.float32],
        recipe: Recipe,
        rows: NDArray[np.int64],
        seed: int,
    ) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        own = replace(denoiser.recipe, radius=recipe.radius, fewest=recipe.fewest)
        source = PatchSource(points, normals, own, diagonal=1.0, seed=seed, workers=1)
        tile = denoiser.inference.denoise(points, normals, source, rows)
        return tile.points, tile.normals

    return apply
