"""Clouds to train on: a shape is made, made noisy and cut into patches.

A share of the clouds is taken through a first pass of a denoiser (in a crop, to keep it cheap), so that a network also
sees what its own second iteration will see.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..geometry.noise import Scale, clean_spacing, normals_reach
from ..geometry.normals import ball_normals, pca_normals
from ..geometry.patches import PatchSource
from ..geometry.recipe import Recipe
from .corruption import Mix
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

MIX = Mix()
FirstPass = Callable[
    [NDArray[np.float64], NDArray[np.float32], Recipe, NDArray[np.int64], int],
    tuple[NDArray[np.float64], NDArray[np.float32]],
]
"""(points, raw normals, recipe, rows, seed) of a crop with diagonal-1 coordinates to those rows denoised."""


class TrainingCloud:
    """A clean cloud, its noisy version and what is needed to cut patches from it."""

    def __init__(self, rng: Generator, recipe: Recipe, first_pass: FirstPass | None, mix: Mix = MIX) -> None:
        shape = random_shape(rng, mix.count(rng), thin=mix.thin)
        keep = mix.kept(rng, shape.points)
        clean, clean_normals = shape.points[keep], shape.normals[keep]
        self._clean_tree = cKDTree(clean)
        noise, level = mix.noise(rng, clean)
        noisy = clean + noise
        normals_radius = 0.0
        later = recipe
        if recipe.adaptive:
            scale = Scale(level, clean_spacing(self._clean_tree))
            radius = recipe.adaptive_radius(scale)
            spread = np.exp(rng.normal(0, RADIUS_SPREAD, 2))
            normals_radius = normals_reach(radius, scale) if recipe.normals == "ball" else 0.0
            recipe, later = (replace(recipe, radius=radius * spread[i], adaptive=0.0, fewest=16) for i in (0, 1))
        self.centres = np.arange(len(noisy))
        crop = rows = self.centres
        if first_pass is not None:
            inner = CROP * later.radius
            distance = np.linalg.norm(noisy - noisy[rng.integers(len(noisy))], axis=1)
            crop = np.flatnonzero(distance < inner + later.radius + recipe.radius)
            rows = np.flatnonzero(distance[crop] < inner + later.radius)
        if first_pass is None or len(rows) > CROP_POINTS:
            normals = ball_normals(noisy, normals_radius) if normals_radius else pca_normals(noisy, workers=1)
        else:
            part, distance = noisy[crop], distance[crop][rows]
            normals = ball_normals(part, normals_radius) if normals_radius else pca_normals(part, workers=1)
            noisy, normals = first_pass(part, normals, recipe, rows, int(rng.integers(1 << 31)))
            clean, clean_normals = clean[crop[rows]], clean_normals[crop[rows]]
            self._clean_tree = cKDTree(clean)
            self.centres, recipe = np.flatnonzero(distance < inner), later
        self.clean, self.clean_normals = clean.astype(np.float32), clean_normals.astype(np.float32)
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
    """A batch of ``size`` patches from ``clouds_a_batch`` random clouds."""
    parts = [
        clouds[int(rng.integers(len(clouds)))].batch(rng, size // clouds_a_batch, edges) for _ in range(clouds_a_batch)
    ]
    points, normals, near, near_normals, clean, clean_normals = (
        torch.from_numpy(np.concatenate(arrays).astype(np.float32, copy=False)) for arrays in zip(*parts, strict=True)
    )
    return Batch(points, normals, Surface(near, near_normals), clean, clean_normals)
