"""Training shapes made by code: no licence attaches to weights trained on them.

Half are constructive solid geometry of primitives (sharp edges, thin plates, exact facet normals), half are level
sets of blended Gaussians with waves on top, whose samples are projected onto the surface and take their normals
from the gradient. Needs the ``train`` extra: manifold3d, scikit-image, trimesh.
"""

from __future__ import annotations

from dataclasses import dataclass

import manifold3d
import numpy as np
import trimesh
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from skimage import measure

ROUND = 160
"""Segments of a full circle: facets of a rounded primitive meet at 2.25 degrees."""
PLATE = 6
"""Number of the thin one among the primitives."""
LEVEL = 0.35
"""Level of the implicit function at the surface."""


@dataclass(frozen=True)
class CleanCloud:
    """Samples of a surface: ``points`` and unit ``normals``, (N, 3) float64, diagonal 1, centred."""

    points: NDArray[np.float64]
    normals: NDArray[np.float64]


def random_shape(rng: Generator, count: int, *, thin: bool = False) -> CleanCloud:
    """Sample ``count`` points of a random shape, ``thin``: of one of plates, area-uniform, with exact normals."""
    for _ in range(50):
        cloud = _solid(rng, count, thin) if thin or rng.random() < 0.5 else _level_set(rng, count)
        if cloud is not None and np.isfinite(cloud.normals).all():
            break
    else:
        raise RuntimeError("no shape could be made in 50 tries")
    extent = np.ptp(cloud.points, axis=0)
    centre = cloud.points.min(0) + extent / 2
    return CleanCloud((cloud.points - centre) / np.linalg.norm(extent), cloud.normals)


def _rotation(rng: Generator) -> NDArray[np.float64]:
    matrix: NDArray[np.float64] = Rotation.random(rng=rng).as_matrix()
    return matrix


def _polygon(rng: Generator, corners: int, low: float, high: float) -> manifold3d.CrossSection:
    angle = np.sort(rng.uniform(0, 2 * np.pi, corners))
    reach = rng.uniform(low, high, corners)
    outline = np.stack([reach * np.cos(angle), reach * np.sin(angle)], 1)
    return manifold3d.CrossSection([outline], manifold3d.FillRule.Positive)


def _primitive(rng: Generator, thin: bool) -> manifold3d.Manifold:
    solid = manifold3d.Manifold
    kind = PLATE if thin else rng.integers(1 + PLATE)
    if kind == 0:
        return solid.cube(tuple(rng.uniform(0.25, 1.1, 3)), True)
    if kind == 1:
        sides = int(rng.choice([3, 4, 5, 6, 8, ROUND, ROUND]))
        return solid.cylinder(rng.uniform(0.2, 1.2), rng.uniform(0.1, 0.5), -1, sides, True)
    if kind == 2:
        sides = int(rng.choice([4, 6, ROUND, ROUND]))
        return solid.cylinder(rng.uniform(0.3, 1.2), rng.uniform(0.2, 0.5), rng.uniform(0, 0.3), sides, True)
    if kind == 3:
        return solid.sphere(rng.uniform(0.2, 0.6), ROUND)
    if kind == 4:
        section = _polygon(rng, int(rng.integers(3, 9)), 0.2, 0.6)
        steps = int(rng.integers(0, 2)) * 40
        taper = (rng.uniform(0.4, 1.0),) * 2
        return solid.extrude(section, rng.uniform(0.1, 0.8), steps, rng.uniform(-60, 60), taper)
    if kind == 5:
        sides = int(rng.choice([4, 6, 96, 96]))
        angle = np.arange(sides) * 2 * np.pi / sides
        ring, tube = rng.uniform(0.35, 0.6), rng.uniform(0.08, 0.25)
        outline = np.stack([ring + tube * np.cos(angle), tube * np.sin(angle)], 1)
        return solid.revolve(manifold3d.CrossSection([outline], manifold3d.FillRule.Positive), ROUND)
    plate = rng.uniform(0.4, 1.2, 3)
    plate[rng.integers(3)] = rng.uniform(0.02, 0.12)
    return solid.cube(tuple(plate), True)


def _solid(rng: Generator, count: int, thin: bool) -> CleanCloud | None:
    solid = _primitive(rng, thin)
    for _ in range(rng.integers(1, 8)):
        pose = np.zeros((3, 4))
        pose[:, :3] = _rotation(rng) if rng.random() < 0.5 else np.eye(3)
        pose[:, 3] = rng.uniform(-0.5, 0.5, 3)
        part, choice = _primitive(rng, thin).transform(pose), rng.random()
        result = solid + part if choice < 0.45 else solid - part if choice < 0.9 else solid ^ part
        if not result.is_empty() and result.volume() > 0.02:
            solid = result
    if solid.is_empty():
        return None
    mesh = solid.to_mesh()
    surface = trimesh.Trimesh(mesh.vert_properties[:, :3], mesh.tri_verts, process=True)
    points, faces = trimesh.sample.sample_surface(surface, count, seed=rng)
    return CleanCloud(np.asarray(points), np.asarray(surface.face_normals[faces]))


class _Blend:
    """Sum of anisotropic Gaussians and sine waves, with its gradient."""

    def __init__(self, rng: Generator) -> None:
        blobs, waves = int(rng.integers(3, 14)), int(rng.integers(0, 7))
        self.centres = rng.uniform(-0.75, 0.75, (blobs, 3))
        turns = np.stack([_rotation(rng) for _ in range(blobs)])
        spread = 1 / rng.uniform(0.1, 0.45, (blobs, 3)) ** 2
        self.forms = np.einsum("bij,bj,bkj->bik", turns, spread, turns)
        self.vectors = rng.normal(size=(waves, 3)) * rng.uniform(3, 24, (waves, 1))
        self.heights = rng.uniform(0.05, 0.6, waves) / np.linalg.norm(self.vectors, axis=1)  # finer waves are lower
        self.phases = rng.uniform(0, 2 * np.pi, waves)

    def __call__(self, at: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Value (N,) and gradient (N, 3) at points (N, 3)."""
        value, gradient = np.zeros(len(at)), np.zeros(at.shape)
        for centre, form in zip(self.centres, self.forms, strict=True):
            offset = at - centre
            slope = offset @ form
            bump = np.exp(-0.5 * (offset * slope).sum(1))
            value += bump
            gradient -= bump[:, None] * slope
        for vector, height, phase in zip(self.vectors, self.heights, self.phases, strict=True):
            angle = at @ vector + phase
            value += height * np.sin(angle)
            gradient += (height * np.cos(angle))[:, None] * vector
        return value, gradient


def _level_set(rng: Generator, count: int) -> CleanCloud | None:
    field, cells, reach = _Blend(rng), 80, 1.5
    axis = np.linspace(-reach, reach, cells)
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    volume = field(grid)[0].reshape(cells, cells, cells)
    if not volume.min() < LEVEL < volume.max():
        return None
    vertices, faces, _, _ = measure.marching_cubes(volume, LEVEL)  # type: ignore[no-untyped-call]
    surface = trimesh.Trimesh(vertices * (2 * reach / (cells - 1)) - reach, faces, process=False)
    points, _ = trimesh.sample.sample_surface(surface, count, seed=rng)
    points = np.asarray(points)
    for _ in range(4):
        value, gradient = field(points)
        step = ((LEVEL - value) / np.maximum((gradient**2).sum(1), 1e-3))[:, None] * gradient
        length = np.linalg.norm(step, axis=1, keepdims=True)
        points = points + step * np.minimum(1, 0.05 / np.maximum(length, 1e-12))
    value, gradient = field(points)
    length = np.linalg.norm(gradient, axis=1)
    good = (np.abs(value - LEVEL) < 1e-3 * np.maximum(length, 1e-6)) & (length > 0.05)
    if good.mean() < 0.98:
        return None
    keep = np.flatnonzero(good)
    keep = np.concatenate([keep, rng.choice(keep, count - len(keep))])
    return CleanCloud(points[keep], -gradient[keep] / length[keep, None])
