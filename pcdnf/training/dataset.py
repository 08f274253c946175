"""Clouds to train on: a shape is made and made noisy, or a scan is simulated and cropped; patches are cut from either.

A share of the clouds is taken through a first pass of a denoiser (in a crop, to keep it cheap), so that a network also
sees what its own second iteration will see.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..geometry.noise import NoiseEstimate, clean_spacing, normals_reach
from ..geometry.normals import ball_normals, pca_normals
from ..geometry.patches import PatchSource
from ..geometry.recipe import Recipe
from ..scanners.catalog import simulate
from ..scanners.crops import Cropper
from .corruption import Corruption
from .losses import Batch, Surface
from .shapes import random_shape

SURFACE_POINTS = 96
"""Clean points around each centre that the losses see."""
CROP = 1.5
"""Where a first pass was made, centres lie within this many patch radii of a random point."""
CROP_POINTS = 12_000
"""Points a first pass may take; a crop with more is left as it is, for the sake of time."""
RADIUS_SPREAD = 0.35
"""Standard deviation of the logarithm of a cloud's patch radius around the recipe's own choice."""
SCAN_POINTS = 80_000
SCAN_RADIUS = 9.8
"""Patch radius of a crop over the geometric mean of its true noise and spacing: as the recipes have it."""
SCAN_FEWEST = (40, 250)
"""Points that a flat patch of a crop holds at least, drawn anew for each."""

CORRUPTION = Corruption()
FirstPass = Callable[
    [NDArray[np.float64], NDArray[np.float32], Recipe, NDArray[np.int64], int],
    tuple[NDArray[np.float64], NDArray[np.float32]],
]
"""(points, raw normals, recipe, rows, seed) of a crop with diagonal-1 coordinates to those rows denoised."""


@dataclass(frozen=True)
class Sample:
    """A noisy cloud with its truth, before patches are cut from it.

    Attributes
    ----------
    noisy, clean, normals : ndarray, (N, 3) float64
        Index-aligned; normals are those of the clean surface.
    centres : ndarray, (C,) int64
        Rows that may be centres of patches.
    true : ndarray, (N,) bool
        Rows whose clean point is known.
    scale : NoiseEstimate
        True noise and spacing.
    radius : float, optional
        Of its patches, before their random factor; by the recipe and the scale where there is none.
    """

    noisy: NDArray[np.float64]
    clean: NDArray[np.float64]
    normals: NDArray[np.float64]
    centres: NDArray[np.int64]
    true: NDArray[np.bool_]
    scale: NoiseEstimate
    radius: float | None = None


def shape_sample(rng: Generator, corruption: Corruption = CORRUPTION) -> Sample:
    """Make a random shape with noise of the corruption."""
    shape = random_shape(rng, corruption.count(rng), thin=corruption.thin)
    keep = corruption.kept(rng, shape.points)
    clean = shape.points[keep]
    noise, level = corruption.noise(rng, clean)
    everything = np.arange(len(clean))
    scale = NoiseEstimate(level, clean_spacing(cKDTree(clean)))
    return Sample(clean + noise, clean, shape.normals[keep], everything, np.ones(len(clean), bool), scale)


def scan_samples(rng: Generator, kind: str, seed: int, count: int) -> list[Sample]:
    """Crops of one simulated scan; fewer than ``count`` where it is sparse."""
    cropper = Cropper(simulate(kind, seed, SCAN_POINTS), SCAN_RADIUS)
    crops = [cropper.crop(rng, int(np.exp(rng.uniform(*np.log(SCAN_FEWEST))))) for _ in range(count)]
    return [
        Sample(
            crop.points, crop.clean, crop.normals, crop.centres, crop.true, NoiseEstimate(crop.noise, crop.spacing), 1.0
        )
        for crop in crops
        if crop is not None
    ]


class TrainingCloud:
    """A sample and what is needed to cut patches from it.

    Parameters
    ----------
    rng : Generator
    sample : Sample
    recipe : Recipe
    first_pass : callable, optional
    """

    def __init__(self, rng: Generator, sample: Sample, recipe: Recipe, first_pass: FirstPass | None = None) -> None:
        noisy, clean, clean_normals, true = sample.noisy, sample.clean, sample.normals, sample.true
        normals_radius = 0.0
        later = recipe
        if recipe.adaptive:
            radius = recipe.adaptive_radius(sample.scale) if sample.radius is None else sample.radius
            spread = np.exp(rng.normal(0, RADIUS_SPREAD, 2))
            normals_radius = normals_reach(radius, sample.scale) if recipe.normals == "ball" else 0.0
            recipe, later = (replace(recipe, radius=radius * spread[i], adaptive=0.0, fewest=16) for i in (0, 1))
        self.centres = sample.centres
        crop = rows = np.arange(len(noisy))
        if first_pass is not None:
            inner = CROP * later.radius
            distance = np.linalg.norm(noisy - noisy[rng.choice(self.centres)], axis=1)
            crop = np.flatnonzero(distance < inner + later.radius + recipe.radius)
            rows = np.flatnonzero(distance[crop] < inner + later.radius)
        if first_pass is None or len(rows) > CROP_POINTS:
            normals = ball_normals(noisy, normals_radius) if normals_radius else pca_normals(noisy, workers=1)
        else:
            part, distance = noisy[crop], distance[crop][rows]
            normals = ball_normals(part, normals_radius) if normals_radius else pca_normals(part, workers=1)
            noisy, normals = first_pass(part, normals, recipe, rows, int(rng.integers(1 << 31)))
            kept = crop[rows]
            clean, clean_normals, true = clean[kept], clean_normals[kept], true[kept]
            may_be_centre = np.zeros(len(sample.noisy), bool)
            may_be_centre[sample.centres] = True
            self.centres, recipe = np.flatnonzero((distance < inner) & may_be_centre[kept]), later
        self.clean, self.clean_normals = clean.astype(np.float32), clean_normals.astype(np.float32)
        self._surface = np.flatnonzero(true)
        self._clean_tree = cKDTree(clean[true])
        self._edges = self.centres[self._near_edge(self.centres)]
        self._source = PatchSource(noisy, normals, recipe, diagonal=1.0, seed=0, workers=1)
        self.noisy = noisy

    def _near_edge(self, index: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Where the clean normals turn by more than 25 degrees within 16 neighbours."""
        if len(self._surface) < 16:
            return np.zeros(len(index), bool)
        _, around = self._clean_tree.query(self.clean[index], 16)
        cosine = (self.clean_normals[self._surface[around]] * self.clean_normals[index, None]).sum(-1)
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
        _, around = self._clean_tree.query(at, min(SURFACE_POINTS, len(self._surface)))
        around = self._surface[around]
        if around.shape[1] < SURFACE_POINTS:
            around = np.resize(around.T, (SURFACE_POINTS, count)).T
        own = np.where(patches.index < 0, patches.index[:, :1], patches.index)
        result = [patches.points, patches.normals]
        for index in (around, own):
            local = (self.clean[index] - at[:, None]).astype(np.float32) / np.float32(self._source.radius)
            result += [local @ turn, self.clean_normals[index] @ turn]
        return result


def _spins(rng: Generator, count: int) -> NDArray[np.float64]:
    """Random rotations about z and reflections (B, 3, 3): the signs of a PCA frame are arbitrary."""
    angle = rng.uniform(0, 2 * np.pi, count)
    flip, up = rng.choice([-1.0, 1.0], (2, count))
    spin = np.zeros((count, 3, 3))
    spin[:, 0, 0], spin[:, 0, 1] = np.cos(angle), -np.sin(angle) * flip
    spin[:, 1, 0], spin[:, 1, 1] = np.sin(angle), np.cos(angle) * flip
    spin[:, 2, 2] = up
    return spin


def sample_batch(clouds: list[TrainingCloud], rng: Generator, size: int, clouds_a_batch: int, edges: float) -> Batch:
    """Make a batch of `size` patches from `clouds_a_batch` random clouds."""
    parts = [
        clouds[int(rng.integers(len(clouds)))].batch(rng, size // clouds_a_batch, edges) for _ in range(clouds_a_batch)
    ]
    points, normals, near, near_normals, clean, clean_normals = (
        torch.from_numpy(np.concatenate(arrays).astype(np.float32, copy=False)) for arrays in zip(*parts, strict=True)
    )
    return Batch(points, normals, Surface(near, near_normals), clean, clean_normals)
