"""Points from images: correlated bumps, density and noise that follow the texture, clusters of outliers.

Semi-global and patch-based matching smooth over windows, so that errors of neighbours are alike over several spacings
(Hirschmüller 2008, "Stereo processing by semiglobal matching and mutual information"; Furukawa and Ponce 2010,
"Accurate, dense, and robust multiview stereopsis"). Where there is little texture there are fewer points, and they are
worse.
"""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from .fields import SmoothField
from .scan import Scan, make_scan
from .scene import Bools, Floats, Ints, Scene
from .surface import Surface


def scan(
    rng: Generator,
    name: str,
    surface: Surface,
    *,
    unit: str,
    points: int,
    noise: float,
    correlation: float,
    white: float,
    texture: float,
    clusters: int,
) -> Scan:
    """Sample a surface as dense matching would.

    Parameters
    ----------
    rng : Generator
    name, unit : str
    surface : Surface
    points : int
    noise : float
        Standard deviation of a point's error along the normal where texture is medium, in spacings.
    correlation : float
        Length over which errors are alike, in spacings.
    white : float
        Share of the variance that is not correlated.
    texture : float
        How much density and noise vary with texture: 0 for evenly.
    clusters : int
        Of outliers.
    """
    scene = surface.scene
    size = float(np.linalg.norm(np.ptp(scene.vertices, axis=0)))
    look = SmoothField(rng, rng.uniform(0.03, 0.15) * size)
    true, face, richness = _sampled(rng, scene, points, look, texture)
    normals = surface.normals[face]
    spacing = float(np.sqrt(scene.face_areas().sum() / points))
    sigma = noise * spacing * np.exp(-0.45 * texture * richness)
    smooth = SmoothField(rng, correlation * spacing)(true)
    error = np.sqrt(1 - white) * smooth + np.sqrt(white) * rng.normal(size=len(true))
    cloud = true + (sigma * error)[:, None] * normals + rng.normal(0, 0.2 * spacing, true.shape) * noise
    outlier = _move_clusters(rng, cloud, true, normals, sigma, clusters)
    sensors = true.mean(0) + size * _around(rng)
    return make_scan(
        name,
        unit,
        surface,
        points=cloud,
        ideal=true,
        sigma=sigma,
        station=_facing(sensors, true, normals),
        sensors=sensors,
        outlier=outlier,
    )


def _sampled(
    rng: Generator, scene: Scene, points: int, look: SmoothField, texture: float
) -> tuple[Floats, Ints, Floats]:
    """Points (N, 3) on the surface, their faces and how rich the texture is there (N,)."""
    area = scene.face_areas()
    many = 3 * points
    face = np.sort(rng.choice(len(area), many, p=area / area.sum()))
    u, v = rng.random((2, many))
    over = u + v > 1
    u, v = np.where(over, 1 - u, u), np.where(over, 1 - v, v)
    corners = scene.triangles[face]
    true = corners[:, 0] + u[:, None] * (corners[:, 1] - corners[:, 0]) + v[:, None] * (corners[:, 2] - corners[:, 0])
    richness = np.clip(look(true), -2, 2)
    weight = np.exp(0.8 * texture * richness)
    kept = np.sort(rng.choice(many, points, replace=False, p=weight / weight.sum()))
    return true[kept], face[kept], richness[kept]


def _move_clusters(rng: Generator, cloud: Floats, true: Floats, normals: Floats, sigma: Floats, clusters: int) -> Bools:
    """Move small neighbourhoods off the surface, in place; which points they are."""
    outlier = np.zeros(len(cloud), bool)
    for _ in range(clusters):
        middle = rng.integers(len(true))
        count = int(rng.integers(8, 60))
        nearest = np.argpartition(((true - true[middle]) ** 2).sum(1), count)[:count]
        off = rng.uniform(5, 25) * sigma[middle] * rng.choice([-1.0, 1.0])
        spread = rng.normal(0, 1.5, (count, 3)) * sigma[middle]
        cloud[nearest] += off * normals[middle] + spread
        outlier[nearest] = True
    return outlier


def _around(rng: Generator) -> Floats:
    """Directions of twelve cameras."""
    direction = rng.normal(size=(12, 3))
    return np.asarray(direction / np.linalg.norm(direction, axis=1, keepdims=True))


def _facing(sensors: Floats, points: Floats, normals: Floats) -> Ints:
    """For each point the camera that its outward normal points to most."""
    best, station = np.full(len(points), -np.inf), np.zeros(len(points), np.int64)
    for number, sensor in enumerate(sensors):
        ray = sensor - points
        cosine = (ray * normals).sum(1) / np.linalg.norm(ray, axis=1)
        better = cosine > best
        best[better], station[better] = cosine[better], number
    return station
