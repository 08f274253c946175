"""A scanner on a tripod: an angular grid, several stations that are registered to one another.

Figures as in data sheets of phase and pulse scanners: range noise of 0.3 to 2 mm at 10 m, a beam of 2 to 4 mm at the
exit that opens by 0.2 to 0.4 mrad; merged stations fit to 1 to 4 mm. HELIOS++ lists 5 mm accuracy and 0.3 mrad for
RIEGL's VZ-400 (Winiwarter et al. 2022). See :mod:`pcdnf.scanners.beam` for incidence and mixed pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from .beam import Beam, dullness, measure
from .poses import registration_error
from .scan import Returns, Scan
from .scene import Floats
from .surface import Surface

LOWEST = np.radians(-60)
"""Elevation below which the tripod is."""


@dataclass(frozen=True)
class Sector:
    """What a station sees: azimuths and elevations, radians, and the step of the grid."""

    azimuth: tuple[float, float]
    elevation: tuple[float, float]
    step: float


def random_beam(rng: Generator) -> Beam:
    """Return a phase scanner (short echoes, quiet) or a pulse scanner."""
    if rng.random() < 0.5:
        return Beam(rng.uniform(0.3e-3, 1.2e-3), rng.uniform(15, 30), 1.1e-3, rng.uniform(1e-4, 1.5e-4), 0.6)
    return Beam(rng.uniform(0.8e-3, 3e-3), rng.uniform(30, 60), 2e-3, rng.uniform(1e-4, 1.8e-4), 0.4)


def scan(
    rng: Generator,
    name: str,
    surface: Surface,
    stations: Floats,
    sectors: list[Sector],
    beam: Beam,
    *,
    shift: float,
    turn: float,
) -> Scan:
    """Scan a scene from stations (S, 3), each over its sector; the first one's frame is the scan's.

    ``shift`` (metres) and ``turn`` (radians) are the registration's standard deviations along and about each axis.
    """
    dull = dullness(rng, len(surface.scene.part_names))
    returns = Returns()
    for number, (at, sector) in enumerate(zip(stations, sectors, strict=True)):
        directions = _grid(sector)
        origins = np.broadcast_to(at, directions.shape)
        echoes = measure(rng, surface, beam, origins, directions, dull)
        ray = directions[echoes.ray]
        true, noisy = at + echoes.ideal[:, None] * ray, at + echoes.measured[:, None] * ray
        registered = noisy if number == 0 else registration_error(rng, at, shift, turn)(noisy)
        returns.add(registered, true, echoes.sigma, registered - noisy, number)
    return returns.scan(name, surface, stations)


def _grid(sector: Sector) -> Floats:
    """Directions (N, 3), line by line as the head turns."""
    azimuth = np.arange(*sector.azimuth, sector.step)
    elevation = np.arange(max(sector.elevation[0], LOWEST), sector.elevation[1], sector.step)
    turn, rise = np.meshgrid(azimuth, elevation, indexing="ij")
    flat = np.cos(rise)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), np.sin(rise)], -1).reshape(-1, 3)
