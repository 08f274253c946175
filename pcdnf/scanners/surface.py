"""Rays cast at a scene and nearest points on it, by Open3D's ``RaycastingScene``."""

from __future__ import annotations

import importlib
import warnings
from dataclasses import dataclass

import numpy as np

from ..errors import PcdnfError
from .scene import Floats, Ints, Scene

_BESIDE = 1e-5 * np.array([[0.53, -0.71, 0.46], [-0.62, 0.35, -0.70]])
"""Steps of second queries, in sizes of the scene."""


@dataclass(frozen=True)
class Hits:
    """Where rays meet a scene.

    Attributes
    ----------
    distance : ndarray, (N,) float64
        Along the ray's direction in its lengths; infinite for a miss.
    face : ndarray, (N,) int64
        -1 for a miss.
    """

    distance: Floats
    face: Ints


@dataclass(frozen=True)
class Nearest:
    """Nearest points on a scene: ``points`` (N, 3), their ``face`` (N,) and ``distance`` (N,)."""

    points: Floats
    face: Ints
    distance: Floats


class Surface:
    """A scene that answers rays and nearest points.

    Parameters
    ----------
    scene : Scene

    Raises
    ------
    PcdnfError
        ``missing_extra`` without Open3D.
    """

    def __init__(self, scene: Scene) -> None:
        try:
            with warnings.catch_warnings():  # that there is no GPU
                warnings.simplefilter("ignore")
                open3d = importlib.import_module("open3d")
        except ImportError as error:
            raise PcdnfError(
                f"Scans cannot be simulated: {error.name} is not installed.",
                code="missing_extra",
                hint="Run: pip install 'pcdnf[scanners]'",
            ) from error
        self.scene = scene
        self.normals = scene.face_normals()
        self._size = float(np.ptp(scene.vertices, axis=0).max())
        self._middle = scene.vertices.mean(0)
        self._corners = scene.vertices[scene.faces[:, 0]]
        self._core = open3d.core
        self._casting = open3d.t.geometry.RaycastingScene(nthreads=1)
        vertices = (scene.vertices - self._middle).astype(np.float32)
        self._casting.add_triangles(self._core.Tensor(vertices), self._core.Tensor(scene.faces.astype(np.uint32)))

    def cast(self, origins: Floats, directions: Floats) -> Hits:
        """Cast rays (N, 3); the distance is computed anew from the face's plane in float64."""
        rays = np.concatenate([origins - self._middle, directions], 1).astype(np.float32)
        answer = self._casting.cast_rays(self._core.Tensor(rays), nthreads=1)
        distance = answer["t_hit"].numpy().astype(np.float64)
        face = answer["primitive_ids"].numpy().astype(np.int64)
        hit = np.isfinite(distance)
        face[~hit] = -1
        at = face[hit]
        slope = (self.normals[at] * directions[hit]).sum(1)
        exact = ((self._corners[at] - origins[hit]) * self.normals[at]).sum(1) / np.where(slope == 0, 1, slope)
        near = np.abs(exact - distance[hit]) < 1e-3 * np.maximum(distance[hit], 1e-9)  # not along a face seen edge-on
        distance[hit] = np.where(near, exact, distance[hit])
        return Hits(distance, face)

    def nearest(self, points: Floats) -> Nearest:
        """Nearest points on the scene to points (N, 3), in float64 on the best of the faces that Open3D names.

        For one point in ten thousand Open3D names another face than the nearest, where slender triangles meet. It
        is asked twice more, a little beside each point.
        """
        best = self._nearest(points, points)
        for step in _BESIDE * self._size:
            other = self._nearest(points, points + step)
            nearer = other.distance < best.distance
            best.points[nearer], best.face[nearer] = other.points[nearer], other.face[nearer]
            best.distance[nearer] = other.distance[nearer]
        return best

    def _nearest(self, points: Floats, queries: Floats) -> Nearest:
        """Nearest points to ``points`` on the faces that are nearest to ``queries``."""
        query = self._core.Tensor((queries - self._middle).astype(np.float32))
        face = self._casting.compute_closest_points(query, nthreads=1)["primitive_ids"].numpy().astype(np.int64)
        foot = _nearest_on_triangles(points, self.scene.triangles[face])
        return Nearest(foot, face, np.linalg.norm(points - foot, axis=1))


def _nearest_on_triangles(points: Floats, corners: Floats) -> Floats:
    """Nearest points (N, 3) to points (N, 3) on one triangle (N, 3, 3) each."""
    origin, first, second = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    offset = points - origin
    a, b, c = (first * first).sum(1), (first * second).sum(1), (second * second).sum(1)
    d, e = (first * offset).sum(1), (second * offset).sum(1)
    scale = np.maximum(a * c - b * b, 1e-300)
    u, v = (c * d - b * e) / scale, (a * e - b * d) / scale
    inside = (u >= 0) & (v >= 0) & (u + v <= 1)
    best = origin + u[:, None] * first + v[:, None] * second
    square = np.where(inside, ((points - best) ** 2).sum(1), np.inf)
    for start, end in ((0, 1), (1, 2), (2, 0)):
        edge = corners[:, end] - corners[:, start]
        share = ((points - corners[:, start]) * edge).sum(1) / np.maximum((edge * edge).sum(1), 1e-300)
        foot = corners[:, start] + np.clip(share, 0, 1)[:, None] * edge
        other = ((points - foot) ** 2).sum(1)
        nearer = ~inside & (other < square)
        best[nearer], square[nearer] = foot[nearer], other[nearer]
    return np.asarray(best)
