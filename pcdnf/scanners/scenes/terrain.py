"""Terrain with buildings, trees and a power line, in metres."""

from __future__ import annotations

from itertools import pairwise
from typing import SupportsFloat

import numpy as np
from numpy.random import Generator

from ..fields import SmoothField
from ..scene import Floats, Scene, SceneBuilder
from ..solids import box, cylinder, height_field, hexahedron, leaves, moved, sagging, tube, turned


def terrain(rng: Generator, size: float = 160.0) -> Scene:
    """Return a square of ground about the origin and what stands on it."""
    scene = SceneBuilder()
    hills, bumps = SmoothField(rng, rng.uniform(40, 90), 2), SmoothField(rng, rng.uniform(4, 10), 2)
    slope, relief = rng.normal(0, 0.06, 2), rng.uniform(1, 8)

    def height(x: Floats, y: Floats) -> Floats:
        at = np.stack([np.ravel(x), np.ravel(y)], 1)
        return np.asarray((relief * hills(at) + 0.15 * bumps(at) + at @ slope).reshape(np.shape(x)))

    axis = np.linspace(-size / 2 - 20, size / 2 + 20, 150)
    scene.add("ground", height_field(axis, axis, height))

    def on_ground(x: SupportsFloat, y: SupportsFloat) -> Floats:
        return np.array([float(x), float(y), float(height(np.array([x], float), np.array([y], float))[0])])

    for x in np.arange(-size / 2 + 20, size / 2, 38):
        for y in np.arange(-size / 2 + 20, size / 2, 34):
            if rng.random() < 0.75:
                _building(rng, scene, on_ground(x + rng.uniform(-5, 5), y + rng.uniform(-4, 4)))
    for x, y in rng.uniform(-size / 2, size / 2, (14, 2)):
        _tree(rng, scene, on_ground(x, y))
    _power_line(rng, scene, [on_ground(x, 0.3 * x + rng.uniform(-3, 3)) for x in np.linspace(-size / 2, size / 2, 4)])
    x, y = rng.uniform(-size / 3, size / 3, 2)
    wall = [on_ground(x + 0.5 * step, y + 0.2 * step) for step in range(60)]
    for one in wall[:-1]:
        scene.add("wall", box(one + [0, -0.12, -0.5], one + [0.52, 0.12, 1.4]), thin=True)
    return scene.build()


def _building(rng: Generator, scene: SceneBuilder, at: Floats) -> None:
    """Add a house with a gable roof, or a flat one with a parapet, a chimney and boxes on top."""
    length, width, eaves, yaw = rng.uniform(9, 18), rng.uniform(7, 11), rng.uniform(3.5, 9), rng.uniform(0, np.pi)
    foot = np.array([length, width, 0]) / 2
    scene.add("house", moved(turned(box(-foot - [0, 0, 2], foot + [0, 0, eaves]), yaw), at))
    if rng.random() < 0.6:
        rise, over = width * rng.uniform(0.25, 0.5), 0.4
        low = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * (foot + [over, over, 0]) + [0, 0, eaves]
        ridge = low * [1, 0, 1] + [0, 0, rise] + np.array([[0, -1e-3, 0], [0, -1e-3, 0], [0, 1e-3, 0], [0, 1e-3, 0]])
        scene.add("roof", moved(turned(hexahedron(low, ridge), yaw), at))
        chimney = box([length * 0.2, -0.35, eaves], [length * 0.2 + 0.7, 0.35, eaves + rise + 0.8])
        scene.add("chimney", moved(turned(chimney, yaw), at))
        for place in rng.uniform(-0.35, 0.35, 2) * length:
            dormer = box([place - 0.8, -width / 2 + 0.5, eaves + 0.2], [place + 0.8, -width / 4, eaves + rise * 0.6])
            scene.add("dormer", moved(turned(dormer, yaw), at))
    else:
        rim, thick = rng.uniform(0.4, 1.0), 0.3
        x, y = foot[:2]
        for start, end in (
            ((-x, -y), (x, -y + thick)),
            ((-x, y - thick), (x, y)),
            ((-x, -y), (-x + thick, y)),
            ((x - thick, -y), (x, y)),
        ):
            scene.add("parapet", moved(turned(box([*start, eaves], [*end, eaves + rim]), yaw), at), thin=True)
        for _ in range(3):
            place = rng.uniform(-0.35, 0.35, 2) * [length, width]
            unit = box([*(place - 0.6), eaves], [*(place + 0.6), eaves + rng.uniform(0.5, 1.5)])
            scene.add("unit", moved(turned(unit, yaw), at))
        scene.add("aerial", cylinder(at + [0, 0, eaves], 3.0, 0.04, 10), thin=True)


def _tree(rng: Generator, scene: SceneBuilder, at: Floats) -> None:
    high, reach = rng.uniform(3, 6), rng.uniform(2, 4)
    scene.add("trunk", tube([at - [0, 0, 0.5], at + [0, 0, high]], 0.25, 12))
    scene.add(
        "leaves", leaves(rng, at + [0, 0, high + 0.5 * reach], [reach, reach, 1.2 * reach], 2500, 0.15), loose=True
    )


def _power_line(rng: Generator, scene: SceneBuilder, feet: list[Floats]) -> None:
    high = rng.uniform(14, 20)
    for foot in feet:
        for x, y in ((-1.2, -1.2), (1.2, -1.2), (1.2, 1.2), (-1.2, 1.2)):
            scene.add("pylon", tube([foot + [x, y, -1], foot + [0.2 * x, 0.2 * y, high]], 0.08, 8), thin=True)
        scene.add("pylon", box(foot + [-0.1, -4, high - 1], foot + [0.1, 4, high - 0.8]), thin=True)
    for start, end in pairwise(feet):
        for offset in (-3.8, 0.0, 3.8):
            shift = np.array([0, offset, high - 1.2])
            scene.add("wire", tube(sagging(start + shift, end + shift, rng.uniform(1, 2.5), 40), 0.015, 8), thin=True)
