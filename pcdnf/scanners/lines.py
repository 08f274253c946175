"""Scanners that move: mobile mapping and airborne strips, whose spacing along a line and across lines differs.

Figures as in data sheets: 5 to 10 mm and 10 cm between the lines for mobile scanners (RIEGL VUX-1: 10 mm accuracy,
5 mm precision); 15 to 30 mm and a beam that opens by 0.25 to 0.5 mrad for airborne ones (Leica ALS50: 0.33 mrad in the
scanner table of HELIOS++, Winiwarter et al. 2022). Passes and strips disagree by centimetres; a trajectory drifts
smoothly in between.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from .beam import Beam, dullness, measure
from .fields import SmoothField
from .scan import Returns, Scan
from .scene import Floats, Ints
from .surface import Surface

DRIFT_LENGTH = 8.0
"""Metres of a trajectory over which its error changes."""


@dataclass(frozen=True)
class Pass:
    """One drive or flight.

    Attributes
    ----------
    start, end : ndarray, (3,)
    spacing : float
        Between lines, metres.
    angles : tuple of float
        First angle, last and step within a line, radians; 0 is downwards.
    skew : float
        Turn of the line's plane about the vertical, radians: 0 is across the trajectory.
    """

    start: Floats
    end: Floats
    spacing: float
    angles: tuple[float, float, float]
    skew: float = 0.0


def mobile_beam(rng: Generator) -> Beam:
    """Return a profile scanner on a car."""
    return Beam(rng.uniform(3e-3, 8e-3), 60.0, 2.5e-3, 2.5e-4, 0.5, longest=120.0)


def airborne_beam(rng: Generator) -> Beam:
    """Return a scanner under an aircraft."""
    return Beam(rng.uniform(1.2e-2, 2.5e-2), 800.0, 1e-2, rng.uniform(1.2e-4, 2.5e-4), 1.5, 2e-5, longest=3000.0)


def scan(
    rng: Generator,
    name: str,
    surface: Surface,
    passes: list[Pass],
    beam: Beam,
    *,
    offset: Floats,
    drift: float,
) -> Scan:
    """Scan a scene in passes.

    Parameters
    ----------
    rng : Generator
    name : str
    surface : Surface
    passes : list of Pass
    beam : Beam
    offset : ndarray, (3,)
        Standard deviation of a pass's own error along each axis, metres.
    drift : float
        Standard deviation of the error that changes along a pass, metres.
    """
    dull = dullness(rng, len(surface.scene.part_names))
    returns, sensors, first = Returns(), [], 0
    for one in passes:
        origins, directions, line = _rays(rng, one)
        echoes = measure(rng, surface, beam, origins, directions, dull)
        at, ray = origins[echoes.ray], directions[echoes.ray]
        shared = rng.normal(0, 1, 3) * offset
        error = shared + drift * _wander(rng, np.linalg.norm(at - one.start, axis=1))
        true, noisy = (at + length[:, None] * ray for length in (echoes.ideal, echoes.measured))
        returns.add(noisy + error, true, echoes.sigma, error, line[echoes.ray] + first)
        lines = int(line.max()) + 1
        sensors.append(one.start + np.arange(lines)[:, None] / max(lines - 1, 1) * (one.end - one.start))
        first += lines
    return returns.scan(name, surface, np.concatenate(sensors))


def _rays(rng: Generator, one: Pass) -> tuple[Floats, Floats, Ints]:
    """Origins and directions (N, 3) of all lines, and each ray's line (N,)."""
    way = one.end - one.start
    length = float(np.linalg.norm(way))
    ahead = way / length
    across = np.array([-ahead[1], ahead[0], 0.0])
    across = np.cos(one.skew) * across + np.sin(one.skew) * ahead
    angle = np.arange(*one.angles)
    angle += rng.uniform(0, one.angles[2])
    lines = max(2, int(length / one.spacing))
    fan = np.sin(angle)[:, None] * across - np.cos(angle)[:, None] * np.array([0, 0, 1.0])
    share = np.arange(lines) / (lines - 1)
    number = np.repeat(np.arange(lines), len(angle))
    # the platform moves on while a line is measured
    within = np.tile(np.arange(len(angle)) / len(angle), lines) / lines
    origins = one.start + (share[number] + within)[:, None] * way
    return origins, np.tile(fan, (lines, 1)), number


def _wander(rng: Generator, along: Floats) -> Floats:
    """Errors (N, 3) of variance 1 that change smoothly along the trajectory."""
    return np.stack([SmoothField(rng, DRIFT_LENGTH, 1)(along[:, None]) for _ in range(3)], 1)
