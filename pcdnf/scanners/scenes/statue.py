"""Smooth bodies with relief, of diagonal 1: blended blobs with bumps, as level sets."""

from __future__ import annotations

import importlib

import numpy as np
from numpy.random import Generator

from ...errors import PcdnfError
from ..fields import SmoothField
from ..scene import Scene

CELLS = 110
"""Of the grid that the level set is taken from, along each side."""
LEVEL = 0.5


def statue(rng: Generator) -> Scene:
    """Return a body of several blobs with fine relief; its mesh is the truth.

    Raises
    ------
    PcdnfError
        ``missing_extra`` without scikit-image.
    """
    try:
        measure = importlib.import_module("skimage.measure")
    except ImportError as error:
        raise PcdnfError(
            f"Statues cannot be made: {error.name} is not installed.",
            code="missing_extra",
            hint="Run: pip install 'pcdnf[scanners]'",
        ) from error
    axis = np.linspace(-1.6, 1.6, CELLS)
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    value = np.zeros(len(grid))
    middle = np.zeros(3)
    for _ in range(int(rng.integers(4, 10))):  # each blob begins within the one before
        reach = rng.uniform(0.15, 0.45, 3)
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        value += np.exp(-0.5 * (((grid - middle) @ turn / reach) ** 2).sum(1))
        middle = np.clip(middle + rng.normal(0, 0.35, 3), -0.8, 0.8)
    near = np.abs(value - LEVEL) < 0.45
    for _ in range(2):
        length = rng.uniform(0.05, 0.2)
        value[near] += rng.uniform(0.02, 0.12) * length / 0.2 * SmoothField(rng, length)(grid[near])
    vertices, faces, _, _ = measure.marching_cubes(value.reshape(CELLS, CELLS, CELLS), LEVEL)
    vertices, faces = np.asarray(vertices, np.float64), np.asarray(faces, np.int64)
    vertices -= (vertices.min(0) + vertices.max(0)) / 2
    vertices /= np.linalg.norm(np.ptp(vertices, axis=0))
    none = np.zeros(1, bool)
    return Scene(vertices, faces[:, ::-1], np.zeros(len(faces), np.int64), ("body",), none, none)
