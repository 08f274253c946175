"""Fringe projection on a turntable: many views of a part, merged by poses that do not quite fit (double layers).

Figures as acceptance tests of such systems give them (VDI/VDE 2634 part 2): probing errors of 10 to 40 um in a field of
100 to 200 mm; views fit to 20 to 60 um. Noise of neighbouring pixels is correlated by the filter of the phase.
"""

from __future__ import annotations

import numpy as np
from numpy.random import Generator
from scipy.ndimage import gaussian_filter

from .poses import looking, registration_error
from .scan import Scan, make_scan
from .scene import Floats
from .surface import Surface

DISTANCE = 4.0
"""Of the sensor from the part's middle, in the part's diagonals."""
STEEPEST = 0.2
"""Cosine of the incidence angle below which the fringes are lost (78 degrees)."""


def scan(
    rng: Generator,
    name: str,
    surface: Surface,
    *,
    unit: str,
    views: int,
    points: int,
    noise: float,
    window: float,
    shift: float,
    turn: float,
) -> Scan:
    """Scan a part.

    Parameters
    ----------
    rng : Generator
    name, unit : str
    surface : Surface
    views, points : int
        Numbers of views and, roughly, of points in all.
    noise, shift : float
        Standard deviations of a depth, and of a view's pose along each axis, in the part's unit.
    window : float
        Standard deviation of the phase filter, pixels.
    turn : float
        Of a view's pose about each axis, radians.
    """
    scene = surface.scene
    low, high = scene.vertices.min(0), scene.vertices.max(0)
    middle, size = (low + high) / 2, float(np.linalg.norm(high - low))
    at = middle + DISTANCE * size * _directions(rng, views)
    side = max(16, int(np.sqrt(3.5 * points / views)))  # some 30 % of the field see the part
    clouds, ideal, sigma, station = [], [], [], []
    for number, origin in enumerate(at):
        axes = looking(middle, origin, roll=rng.uniform(0, 2 * np.pi))
        true, noisy, deviation = _view(rng, surface, origin, axes, side, noise, window)
        registered = registration_error(rng, middle, shift, turn)(noisy)
        clouds.append(registered)
        ideal.append(true)
        sigma.append(np.hypot(deviation, np.linalg.norm(registered - noisy, axis=1) / np.sqrt(3)))
        station.append(np.full(len(noisy), number))
    return make_scan(
        name,
        unit,
        surface,
        points=np.concatenate(clouds),
        ideal=np.concatenate(ideal),
        sigma=np.concatenate(sigma),
        station=np.concatenate(station),
        sensors=at,
    )


def _directions(rng: Generator, views: int) -> Floats:
    """Of the sensor: two rounds of the turntable at two tilts, and some from below as the part is turned over."""
    turn = np.arange(views) * 2 * np.pi * 2 / views + rng.uniform(0, 2 * np.pi)
    tilt = np.radians(np.resize([25.0, 60.0, -35.0], views)) + rng.normal(0, 0.08, views)
    return np.stack([np.cos(tilt) * np.cos(turn), np.cos(tilt) * np.sin(turn), np.sin(tilt)], 1)


def _view(
    rng: Generator, surface: Surface, origin: Floats, axes: Floats, side: int, noise: float, window: float
) -> tuple[Floats, Floats, Floats]:
    """One view: noise-free points, measured points (N, 3), standard deviations (N,)."""
    angle = np.linspace(-0.5, 0.5, side) / DISTANCE
    across, along = np.meshgrid(angle, angle, indexing="ij")
    ray = np.stack([across, along, np.ones_like(across)], -1).reshape(-1, 3) @ axes
    hits = surface.cast(np.broadcast_to(origin, ray.shape), ray)
    cosine = np.abs((surface.normals[hits.face] * ray).sum(1)) / np.linalg.norm(ray, axis=1)
    kept = np.flatnonzero((hits.face >= 0) & (cosine > STEEPEST))
    white = rng.normal(size=(side, side))
    smooth = gaussian_filter(white, window, mode="wrap")
    error = (0.85 * smooth / smooth.std() + np.sqrt(1 - 0.85**2) * rng.normal(size=white.shape)).ravel()
    deviation = noise / np.sqrt(np.maximum(cosine, STEEPEST)) / np.linalg.norm(ray, axis=1)
    true = origin + hits.distance[kept, None] * ray[kept]
    noisy = true + (deviation * error)[kept, None] * ray[kept]
    return true, noisy, (deviation * np.linalg.norm(ray, axis=1))[kept]
