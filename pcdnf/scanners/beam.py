"""What a laser beam measures: a footprint, echoes that merge, noise by range, incidence and reflectance.

Sources. Noise grows with the incidence angle as 1 / cos (Soudarissanane, Lindenbergh, Menenti and Teunissen 2009,
"Incidence angle influence on the quality of terrestrial laser scanning points"; 2011, "Scanning geometry: influencing
factor on the quality of terrestrial laser scanning points"). Echoes nearer to one another than half a pulse come back
as one, between the surfaces: mixed pixels. A pulse is 5 ns in RIEGL's VZ-400 and 10 ns in Leica's ALS50 (scanner tables
of HELIOS++, Winiwarter et al. 2022).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from .scene import Floats, Ints
from .surface import Surface

STEEPEST = 0.06
"""Cosine of the incidence angle below which noise grows no more (86.6 degrees)."""
FAINTEST = 0.02
"""Cosine of the incidence angle below which nothing comes back."""
RING = 0.65
"""Where the outer rays of a footprint lie, in radii at which the intensity has fallen to exp(-2)."""
OUTER = 6
"""Outer rays of a footprint."""


@dataclass(frozen=True)
class Beam:
    """A range finder.

    Attributes
    ----------
    noise : float
        Standard deviation of a range at close distance, at right angles, on a medium surface; metres.
    doubling : float
        Range at which the noise is the square root of two times that, metres.
    waist, divergence : float
        Radius of the beam at its exit, metres; half of its full opening angle, radians.
    merging : float
        Echoes nearer to one another than this merge, metres.
    pointing : float
        Standard deviation of a direction, radians.
    longest : float
        Range, metres.
    """

    noise: float
    doubling: float
    waist: float
    divergence: float
    merging: float
    pointing: float = 1e-5
    longest: float = 300.0


@dataclass(frozen=True)
class Echoes:
    """Ranges that came back.

    Attributes
    ----------
    ray : ndarray, (N,) int64
        Rows of the rays cast.
    ideal, measured, sigma : ndarray, (N,) float64
        Ranges without and with noise, and the standard deviation of the noise, metres.
    """

    ray: Ints
    ideal: Floats
    measured: Floats
    sigma: Floats


def measure(
    rng: Generator, surface: Surface, beam: Beam, origins: Floats, directions: Floats, dullness: Floats
) -> Echoes:
    """Measure along rays.

    Parameters
    ----------
    rng : Generator
    surface : Surface
    beam : Beam
    origins, directions : ndarray, (N, 3) float64
        Directions of length 1.
    dullness : ndarray, (P,) float64
        What noise is multiplied with on each part: the square root of how much less than a medium surface it reflects.

    Returns
    -------
    Echoes
        The strongest of each ray, of the rays that return one.
    """
    true = directions + rng.normal(0, beam.pointing, directions.shape)
    true /= np.linalg.norm(true, axis=1, keepdims=True)
    distance, cosine, face, weight = _footprint(surface, beam, origins, true)
    weight = weight * np.maximum(cosine, 0.05) * (distance < beam.longest) * (cosine > FAINTEST)
    distance = np.where(np.isfinite(distance), distance, 0.0)  # misses weigh nothing
    behind = distance[:, None, :] - distance[:, :, None]  # of each sub-ray (last) behind each (middle)
    together = (behind >= 0) & (behind <= beam.merging)
    power = (together * weight[:, None, :]).sum(2)  # of the echo that begins at each sub-ray
    first = np.where(weight > 0, power, 0).argmax(1)
    rows = np.arange(len(origins))
    member = together[rows, first] * weight
    found = np.flatnonzero(member.sum(1) > 0.1 * weight.max(initial=1e-9))
    member = member[found]
    ideal = (member * distance[found]).sum(1) / member.sum(1)
    slope = (member * cosine[found]).sum(1) / member.sum(1)
    part = surface.scene.face_part[face[found, first[found]]]
    sigma = beam.noise * np.hypot(1, ideal / beam.doubling) * dullness[part] / np.maximum(slope, STEEPEST)
    return Echoes(found, ideal, ideal + rng.normal(size=len(found)) * sigma, sigma)


def _footprint(
    surface: Surface, beam: Beam, origins: Floats, directions: Floats
) -> tuple[Floats, Floats, Ints, Floats]:
    """Distance, cosine of incidence and face of each sub-ray (N, 1 + OUTER), and the sub-rays' weights (1 + OUTER,)."""
    helper = np.where(np.abs(directions[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    side = np.cross(directions, helper)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    other = np.cross(directions, side)
    angle = np.arange(OUTER) * 2 * np.pi / OUTER
    columns = [surface.cast(origins, directions)]
    for turn in angle:
        across = RING * (np.cos(turn) * side + np.sin(turn) * other)
        columns.append(surface.cast(origins + beam.waist * across, directions + beam.divergence * across))
    distance = np.stack([column.distance for column in columns], 1)
    face = np.stack([column.face for column in columns], 1)
    cosine = np.abs((surface.normals[face] * directions[:, None]).sum(2))
    cosine[face < 0] = 0
    weight = np.full(1 + OUTER, np.exp(-2 * RING**2))
    weight[0] = 1
    return distance, cosine, face, weight


def dullness(rng: Generator, parts: int) -> Floats:
    """Of each part: reflectances between 10 % and 90 %, half being medium."""
    return np.asarray(np.sqrt(0.5 / rng.uniform(0.1, 0.9, parts)))
