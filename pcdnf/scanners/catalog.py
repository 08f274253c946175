"""Every kind of simulated scan, each a function of its seed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.random import Generator

from ..errors import PcdnfError
from . import depth_camera, lines, photogrammetry, structured_light, terrestrial
from .scan import Scan
from .scenes.part import part
from .scenes.room import room, table_top
from .scenes.statue import statue
from .scenes.street import facade, street
from .scenes.terrain import terrain
from .surface import Surface

POINTS = 80_000
"""Of a scan, roughly."""


def simulate(kind: str, seed: int, points: int = POINTS) -> Scan:
    """Simulate a scan.

    Parameters
    ----------
    kind : str
        One of :data:`KINDS`.
    seed : int
    points : int
        Roughly how many the scan has.

    Returns
    -------
    Scan
        The same for the same arguments.

    Raises
    ------
    PcdnfError
        ``unknown_scanner``; ``missing_extra`` without the extra ``scanners``.
    """
    if kind not in KINDS:
        raise PcdnfError(
            f"There is no kind of scan named {kind!r}.",
            code="unknown_scanner",
            hint=f"Use some of {', '.join(KINDS)}.",
        )
    rng = np.random.default_rng((seed, list(KINDS).index(kind)))
    return KINDS[kind](rng, f"{kind}-{seed}", points)


def _terrestrial_room(rng: Generator, name: str, points: int) -> Scan:
    """One station or two in a furnished room, the whole of it or a sector at a finer step."""
    scene, size = room(rng)
    count = int(rng.integers(1, 3))
    stations = np.array([[0.35 + 0.3 * n, 0.4 + 0.2 * n, 0.0] for n in range(count)]) * size + [
        0,
        0,
        rng.uniform(1.2, 1.7),
    ]
    wide = rng.choice([2 * np.pi, np.pi, 1.5])
    low, high = (terrestrial.LOWEST, 1.4) if wide > 4 else (-0.9, 0.5)
    step = np.sqrt(wide * (high - low) * count / points)
    sectors = []
    for _ in range(count):
        start = rng.uniform(0, 2 * np.pi)
        sectors.append(terrestrial.Sector((start, start + wide), (low, high), step))
    beam = terrestrial.random_beam(rng)
    return terrestrial.scan(
        rng, name, Surface(scene), stations, sectors, beam, shift=rng.uniform(0.5e-3, 2e-3), turn=2e-4
    )


def _terrestrial_street(rng: Generator, name: str, points: int) -> Scan:
    """Two or three stations in a street, or a sector of one facade side at a finer step."""
    scene, half = street(rng)
    count = int(rng.integers(1, 4))
    stations = np.array([[18.0 * (n - (count - 1) / 2), rng.uniform(-0.3, 0.3) * half, 1.6] for n in range(count)])
    wide = rng.choice([2 * np.pi, 2.2])
    low, high = (-0.6, 0.9)
    step = np.sqrt(wide * (high - low) * count * 0.8 / points)
    start = rng.choice([0.0, np.pi]) + 0.4
    sectors = [terrestrial.Sector((start, start + wide), (low, high), step)] * count
    beam = terrestrial.random_beam(rng)
    return terrestrial.scan(
        rng, name, Surface(scene), stations, sectors, beam, shift=rng.uniform(1e-3, 4e-3), turn=1e-4
    )


def _mobile_street(rng: Generator, name: str, points: int) -> Scan:
    """Simulate a car that drives through a street, once or there and back."""
    scene, half = street(rng)
    count = int(rng.integers(1, 3))
    length, step = rng.uniform(15, 30), np.radians(rng.uniform(0.15, 0.4))
    lines_each = points / count / (0.75 * 2 * np.pi / step)
    passes = []
    for number in range(count):
        y = (-1) ** number * 0.3 * half
        ends = [np.array([-length / 2, y, 2.2]), np.array([length / 2, y, 2.2])]
        start, end = ends if number == 0 else ends[::-1]
        skew = rng.choice([0.0, 0.5, 0.78])
        passes.append(lines.Pass(start, end, length / lines_each, (-np.pi, np.pi, step), skew))
    offset = np.array([1.0, 1.0, 1.0]) * rng.uniform(2e-3, 1e-2)
    return lines.scan(
        rng, name, Surface(scene), passes, lines.mobile_beam(rng), offset=offset, drift=rng.uniform(0, 3e-3)
    )


def _airborne_terrain(rng: Generator, name: str, points: int) -> Scan:
    """Two or three strips over terrain with buildings."""
    scene = terrain(rng)
    count, height = int(rng.integers(1, 4)), rng.uniform(300, 700)
    opening = np.arctan(80 / height)
    each = points / count
    stretch = rng.uniform(0.5, 2.0)  # spacing along the flight against across
    across = np.sqrt(160 * 160 / each / stretch)
    passes = []
    for number in range(count):
        y = 20.0 * (number - (count - 1) / 2)
        start, end = np.array([-80, y, height]), np.array([80, y, height])
        turn = np.pi / 2 if number == 2 else 0.0
        spin = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
        angles = (-opening, opening, across / height)
        passes.append(lines.Pass(spin @ start, spin @ end, across * stretch, angles))
    offset = np.array([0.03, 0.03, 0.02]) * rng.uniform(0.5, 1.5)
    return lines.scan(rng, name, Surface(scene), passes, lines.airborne_beam(rng), offset=offset, drift=5e-3)


def _depth_frame(rng: Generator, name: str, points: int) -> Scan:
    """One frame of a table top or a room."""
    surface, origin, target = _depth_view(rng)
    camera = depth_camera.random_camera(rng).resized(int(np.sqrt(points / 0.75)))
    return depth_camera.scan(rng, name, surface, camera, origin[None], target[None], shift=0.0, turn=0.0)


def _depth_fused(rng: Generator, name: str, points: int) -> Scan:
    """Several frames from nearby, merged by odometry."""
    surface, origin, target = _depth_view(rng)
    count = int(rng.integers(3, 7))
    camera = depth_camera.random_camera(rng).resized(int(np.sqrt(points / count / 0.75)))
    origins = origin + rng.normal(0, 0.12, (count, 3))
    targets = target + rng.normal(0, 0.1, (count, 3))
    shift = rng.uniform(0.5e-3, 3e-3)
    return depth_camera.scan(rng, name, surface, camera, origins, targets, shift=shift, turn=rng.uniform(2e-4, 1.5e-3))


def _depth_view(rng: Generator) -> tuple[Surface, np.ndarray, np.ndarray]:
    if rng.random() < 0.6:
        scene, middle = table_top(rng)
        origin = middle + [rng.uniform(-0.6, 0.6), rng.uniform(-1.4, -0.8), rng.uniform(0.25, 0.8)]
        return Surface(scene), origin, middle + [0, 0.1, 0]
    scene, size = room(rng)
    origin = size * [rng.uniform(0.3, 0.5), rng.uniform(0.35, 0.5), 0] + [0, 0, rng.uniform(1.2, 1.6)]
    turn = rng.uniform(0, 2 * np.pi)
    return Surface(scene), origin, origin + [np.cos(turn), np.sin(turn), rng.uniform(-0.5, -0.1)]


def _structured_light(rng: Generator, name: str, points: int) -> Scan:
    """Scan a machine part on a turntable."""
    return structured_light.scan(
        rng,
        name,
        Surface(part(rng)),
        unit="mm",
        views=int(rng.integers(6, 17)),
        points=points,
        noise=rng.uniform(0.012, 0.04),
        window=rng.uniform(0.7, 1.5),
        shift=rng.uniform(0.015, 0.06),
        turn=rng.uniform(1e-4, 6e-4),
    )


def _photogrammetry(rng: Generator, name: str, points: int) -> Scan:
    """Match images of a statue, or a house front."""
    whole = rng.random() < 0.7
    return photogrammetry.scan(
        rng,
        name,
        Surface(statue(rng) if whole else facade(rng)),
        unit="diag" if whole else "m",
        points=points,
        noise=float(np.exp(rng.uniform(*np.log([0.3, 1.5])))),
        correlation=rng.uniform(3, 10) / 2,  # bumps are about two correlation lengths wide
        white=rng.uniform(0.1, 0.4),
        texture=rng.uniform(0.3, 1.2),
        clusters=int(rng.integers(3, 25)),
    )


def _graded(rng: Generator, name: str, points: int) -> Scan:
    """Sample a statue or a part with white noise that varies manyfold over it, evenly sampled: a control."""
    body = statue(rng) if rng.random() < 0.6 else part(rng)
    return photogrammetry.scan(
        rng,
        name,
        Surface(body),
        unit="diag",
        points=points,
        noise=float(np.exp(rng.uniform(*np.log([0.4, 2.0])))),
        correlation=1.0,
        white=1.0,
        texture=rng.uniform(0.8, 1.3),
        clusters=0,
    )


KINDS: dict[str, Callable[[Generator, str, int], Scan]] = {
    "terrestrial-room": _terrestrial_room,
    "terrestrial-street": _terrestrial_street,
    "mobile-street": _mobile_street,
    "airborne-terrain": _airborne_terrain,
    "depth-frame": _depth_frame,
    "depth-fused": _depth_fused,
    "structured-light": _structured_light,
    "photogrammetry": _photogrammetry,
    "graded": _graded,
}
"""Kinds of scan by name."""
