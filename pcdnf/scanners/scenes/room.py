"""Rooms with furniture, and table tops, in metres."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.random import Generator

from ..scene import Floats, Mesh, Scene, SceneBuilder
from ..solids import box, cylinder, lathe, leaves, moved, sphere, tube, turned

WALL = 0.15


def room(rng: Generator) -> tuple[Scene, Floats]:
    """Return a room, and where one may stand in it: its inner size (3,), from a corner at the origin."""
    size = np.array([rng.uniform(3.5, 7.5), rng.uniform(3.0, 6.0), rng.uniform(2.4, 3.1)])
    scene = SceneBuilder()
    scene.add("floor", box([-WALL, -WALL, -0.1], [size[0] + WALL, size[1] + WALL, 0]))
    scene.add("ceiling", box([-WALL, -WALL, size[2]], [size[0] + WALL, size[1] + WALL, size[2] + 0.1]))
    _walls(rng, scene, size)
    for place in range(4):  # along the two long walls
        along = size[0] * (0.25 + 0.5 * (place % 2)) + rng.uniform(-0.2, 0.2)
        yaw, at = (0.0, np.array([along, 0.02, 0.0])) if place < 2 else (np.pi, np.array([along, size[1] - 0.02, 0.0]))
        _furnish(rng, scene, at, yaw)
    middle = np.array([size[0] * rng.uniform(0.4, 0.6), size[1] * rng.uniform(0.4, 0.6), 0.0])
    _table(rng, scene, middle, rng.uniform(0, np.pi))
    _lamp(rng, scene, np.array([rng.uniform(0.4, size[0] - 0.4), 0.5, 0.0]))
    if rng.random() < 0.5:
        _plant(rng, scene, np.array([size[0] - 0.5, size[1] - 0.5, 0.0]))
    return scene.build(), size


def table_top(rng: Generator) -> tuple[Scene, Floats]:
    """Return a table with things on it before a wall, and the middle of its top (3,)."""
    scene = SceneBuilder()
    height, half = rng.uniform(0.65, 0.8), rng.uniform(0.45, 0.8)
    scene.add("floor", box([-2.5, -1.5, -0.1], [2.5, 1.8, 0]))
    scene.add("wall", box([-2.5, rng.uniform(1.0, 1.7), 0], [2.5, 1.9, 2.5]))
    scene.add("table", box([-half, -0.4, height - 0.03], [half, 0.4, height]))
    for x in (-half + 0.05, half - 0.05):
        scene.add("leg", *(box([x - 0.02, y - 0.02, 0], [x + 0.02, y + 0.02, height - 0.03]) for y in (-0.36, 0.36)))
    for number in range(int(rng.integers(6, 12))):
        at = np.array([rng.uniform(-half + 0.1, half - 0.1), rng.uniform(-0.3, 0.3), height])
        _thing(rng, scene, at, number)
    back = np.array([rng.uniform(-1.5, 1.0), 0.9, 0.0])
    _furnish(rng, scene, back + [0.5, 0.4, 0.0], np.pi)
    return scene.build(), np.array([0.0, 0.0, height])


def _walls(rng: Generator, scene: SceneBuilder, size: Floats) -> None:
    """Four walls: a window with a sill in one, a door frame and a skirting board on the others."""
    x, y, z = size
    scene.add("wall", box([-WALL, -WALL, 0], [0, y + WALL, z]), box([x, -WALL, 0], [x + WALL, y + WALL, z]))
    scene.add("wall", box([0, -WALL, 0], [x, 0, z]))
    left, right = x * rng.uniform(0.2, 0.3), x * rng.uniform(0.6, 0.8)
    low, high = rng.uniform(0.8, 1.0), z - rng.uniform(0.2, 0.5)
    scene.add("wall", box([0, y, 0], [left, y + WALL, z]), box([right, y, 0], [x, y + WALL, z]))
    scene.add("wall", box([left, y, 0], [right, y + WALL, low]), box([left, y, high], [right, y + WALL, z]))
    scene.add("pane", box([left, y + 0.10, low], [right, y + 0.11, high]))
    scene.add("sill", box([left - 0.05, y - 0.15, low - 0.025], [right + 0.05, y + 0.1, low]), thin=True)
    for bar in np.linspace(left, right, int(rng.integers(2, 5)) + 1)[1:-1]:
        scene.add("bar", box([bar - 0.02, y + 0.06, low], [bar + 0.02, y + 0.10, high]), thin=True)
    scene.add("skirting", box([0, 0, 0], [x, 0.012, 0.08]), box([0, 0, 0], [0.012, y, 0.08]), thin=True)
    door = y * rng.uniform(0.2, 0.5)
    scene.add("frame", box([x - 0.02, door, 0], [x, door + 0.08, 2.05]), thin=True)
    scene.add("frame", box([x - 0.02, door + 0.9, 0], [x, door + 0.98, 2.05]), thin=True)
    scene.add("frame", box([x - 0.02, door, 2.05], [x, door + 0.98, 2.13]), thin=True)
    if rng.random() < 0.6:
        _radiator(scene, left, right, y, low)
    if rng.random() < 0.6:
        for beam in np.arange(0.5, x, rng.uniform(0.7, 1.1)):
            scene.add("beam", box([beam, 0, z - 0.14], [beam + 0.1, y, z]))


def _radiator(scene: SceneBuilder, left: float, right: float, y: float, low: float) -> None:
    for fin in map(float, np.arange(left + 0.05, right - 0.05, 0.06)):
        scene.add("fin", box([fin, y - 0.10, 0.12], [fin + 0.015, y - 0.02, low - 0.15]), thin=True)
    scene.add("pipe", *(tube([[left, y - 0.06, z], [right, y - 0.06, z]], 0.015) for z in (0.16, low - 0.2)), thin=True)


def _furnish(rng: Generator, scene: SceneBuilder, at: Floats, yaw: float) -> None:
    """One piece of furniture with its back at ``at``, facing +y before it is turned."""
    kind = rng.integers(4)
    if kind == 0:
        _shelf(rng, scene, at, yaw)
    elif kind == 1:
        width, deep, high = rng.uniform(0.8, 1.4), rng.uniform(0.35, 0.55), rng.uniform(0.7, 1.9)
        body = box([-width / 2, 0, 0.06], [width / 2, deep, high])
        doors = [box([x + 0.005, deep, 0.08], [x + width / 2 - 0.005, deep + 0.018, high]) for x in (-width / 2, 0.0)]
        knobs = [sphere([s * 0.04, deep + 0.035, high * 0.6], 0.015, 8) for s in (-1, 1)]
        scene.add("cupboard", *(_placed(mesh, at, yaw) for mesh in [body, *doors, *knobs]))
    elif kind == 2:
        _sofa(rng, scene, at, yaw)
    else:
        high = rng.uniform(0.4, 0.9)
        scene.add("bench", _placed(box([-0.6, 0.05, high - 0.04], [0.6, 0.45, high]), at, yaw))
        feet = [box([x, 0.1, 0], [x + 0.03, 0.4, high - 0.04]) for x in (-0.55, 0.52)]
        scene.add("foot", *(_placed(mesh, at, yaw) for mesh in feet), thin=True)
        _thing(rng, scene, _placed_point(np.array([0.2, 0.25, high]), at, yaw), 0)


def _shelf(rng: Generator, scene: SceneBuilder, at: Floats, yaw: float) -> None:
    width, deep, high, board = rng.uniform(0.7, 1.3), rng.uniform(0.22, 0.35), rng.uniform(1.2, 2.1), 0.018
    levels = np.linspace(0.08, high - board, int(rng.integers(4, 7)))
    sides = [box([x, 0, 0], [x + board, deep, high]) for x in (-width / 2, width / 2 - board)]
    boards = [box([-width / 2, 0, z], [width / 2, deep, z + board]) for z in levels]
    scene.add("board", *(_placed(mesh, at, yaw) for mesh in [*sides, *boards]), thin=True)
    for low, above in pairwise(levels):
        x = -width / 2 + 0.03
        while x < width / 2 - 0.1 and rng.random() < 0.9:
            thick, tall = rng.uniform(0.015, 0.05), (above - low) * rng.uniform(0.5, 0.85)
            book = box([x, 0.02, low + board], [x + thick, deep * rng.uniform(0.6, 0.95), low + board + tall])
            scene.add("book", _placed(book, at, yaw))
            x += thick + rng.choice([0.001, 0.004, 0.06])


def _sofa(rng: Generator, scene: SceneBuilder, at: Floats, yaw: float) -> None:
    width = rng.uniform(1.2, 2.0)
    pieces = [
        box([-width / 2, 0.2, 0.1], [width / 2, 0.85, 0.4]),
        box([-width / 2, 0.02, 0.1], [width / 2, 0.22, 0.85]),
    ]
    pieces += [tube([[x, 0.1, 0.55], [x, 0.8, 0.55]], 0.09, 24) for x in (-width / 2, width / 2)]
    pieces += [sphere([rng.uniform(-0.3, 0.3) * width, 0.35, 0.52], [0.22, 0.1, 0.17]) for _ in range(2)]
    scene.add("sofa", *(_placed(mesh, at, yaw) for mesh in pieces))


def _table(rng: Generator, scene: SceneBuilder, at: Floats, yaw: float) -> None:
    length, width, high = rng.uniform(1.0, 1.8), rng.uniform(0.7, 0.9), rng.uniform(0.7, 0.76)
    scene.add("table", _placed(box([-length / 2, -width / 2, high - 0.025], [length / 2, width / 2, high]), at, yaw))
    corners = [(x, y) for x in (-length / 2 + 0.08, length / 2 - 0.08) for y in (-width / 2 + 0.08, width / 2 - 0.08)]
    scene.add("leg", *(_placed(cylinder([x, y, 0], high - 0.025, 0.025), at, yaw) for x, y in corners), thin=True)
    for number in range(int(rng.integers(2, 6))):
        place = np.array([rng.uniform(-0.4, 0.4) * length, rng.uniform(-0.35, 0.35) * width, high])
        _thing(rng, scene, _placed_point(place, at, yaw), number)
    for side in (-1, 1):
        _chair(
            scene,
            _placed_point(np.array([rng.uniform(-0.3, 0.3), side * (width / 2 + 0.15), 0]), at, yaw),
            yaw + (side > 0) * np.pi,
        )


def _chair(scene: SceneBuilder, at: Floats, yaw: float) -> None:
    scene.add("seat", _placed(box([-0.21, -0.21, 0.43], [0.21, 0.21, 0.45]), at, yaw), thin=True)
    legs = [cylinder([x, y, 0], 0.43, 0.014, 12) for x in (-0.19, 0.19) for y in (-0.19, 0.19)]
    rails = [cylinder([x, -0.2, 0.45], 0.45, 0.011, 12) for x in np.linspace(-0.18, 0.18, 5)]
    top = box([-0.21, -0.215, 0.86], [0.21, -0.19, 0.93])
    scene.add("leg", *(_placed(mesh, at, yaw) for mesh in legs), thin=True)
    scene.add("rail", *(_placed(mesh, at, yaw) for mesh in [*rails, top]), thin=True)


def _lamp(rng: Generator, scene: SceneBuilder, at: Floats) -> None:
    high = rng.uniform(1.3, 1.7)
    scene.add("lamp", cylinder(at, 0.025, 0.14), thin=False)
    scene.add("rod", cylinder(at, high, 0.011, 12), thin=True)
    scene.add("shade", lathe(at, np.array([[0.2, high - 0.12], [0.1, high + 0.18]])), thin=True)
    path = at + np.array([[0.05, 0, 0.008], [0.3, 0.1, 0.008], [0.5, -0.2, 0.008], [0.9, -0.35, 0.008]])
    scene.add("cable", tube(path, 0.004, 8), thin=True)


def _plant(rng: Generator, scene: SceneBuilder, at: Floats) -> None:
    scene.add("pot", lathe(at, [[0.0, 0.0], [0.13, 0.0], [0.17, 0.3], [0.15, 0.3], [0.14, 0.27], [0.0, 0.27]]))
    scene.add("leaves", leaves(rng, at + [0, 0, 0.75], [0.3, 0.3, 0.45], 250, 0.05), loose=True)


def _thing(rng: Generator, scene: SceneBuilder, at: Floats, number: int) -> None:
    """One thing of a table: a vase, box, ball, can, bowl, book on end or lamp arm."""
    kind, name = int(rng.integers(7)), f"thing {number}"
    if kind == 0:
        heights = np.linspace(0, rng.uniform(0.15, 0.35), 24)
        wide = 0.05 + 0.03 * np.sin(heights * rng.uniform(8, 25) + rng.uniform(0, 6)) + 0.01
        scene.add(name, lathe(at, np.stack([wide, heights], 1)))
    elif kind == 1:
        size = rng.uniform(0.05, 0.2, 3)
        scene.add(name, turned(moved(box(-size / 2, size / 2), at + [0, 0, size[2] / 2]), rng.uniform(0, 3), at))
    elif kind == 2:
        reach = rng.uniform(0.04, 0.11)
        scene.add(name, sphere(at + [0, 0, reach], reach))
    elif kind == 3:
        scene.add(name, cylinder(at, rng.uniform(0.08, 0.2), rng.uniform(0.03, 0.06), 48))
    elif kind == 4:
        angle = np.linspace(0, np.pi / 2, 12)
        outer = np.stack([np.sin(angle), 1 - np.cos(angle)], 1)
        scene.add(name, lathe(at, 0.1 * np.concatenate([outer, outer[::-1] * 0.93 + [0, 0.07]])), thin=True)
    elif kind == 5:
        stand = box([-0.01, -0.09, 0], [0.01, 0.09, rng.uniform(0.18, 0.28)])
        scene.add(name, turned(moved(stand, at), rng.uniform(0, 3), at), thin=True)
    else:
        path = at + np.array([[0, 0, 0.01], [0, 0, 0.25], [0.05, 0, 0.4], [0.2, 0, 0.42]])
        scene.add(name, tube(path, 0.008, 12), cylinder(at, 0.015, 0.07), thin=True)


def _placed(mesh: Mesh, at: Floats, yaw: float) -> Mesh:
    return moved(turned(mesh, yaw), at)


def _placed_point(point: Floats, at: Floats, yaw: float) -> Floats:
    cosine, sine = np.cos(yaw), np.sin(yaw)
    return np.array([cosine * point[0] - sine * point[1], sine * point[0] + cosine * point[1], point[2]]) + at
