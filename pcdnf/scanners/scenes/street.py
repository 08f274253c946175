"""Streets along x: facades, ground, poles, wires, trees, cars, in metres."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.random import Generator

from ..fields import SmoothField
from ..scene import Floats, Mesh, Scene, SceneBuilder
from ..solids import box, cylinder, height_field, hexahedron, leaves, sagging, sphere, tube, turned


def street(rng: Generator, length: float = 60.0) -> tuple[Scene, float]:
    """Return a street with the middle of its road on the x axis, and half of its width between the facades."""
    half = rng.uniform(6.0, 10.0)
    scene = SceneBuilder()
    _ground(rng, scene, length, half)
    for side in (-1.0, 1.0):
        x = -length / 2
        while x < length / 2 - 4:
            width = min(rng.uniform(8, 16), length / 2 - x)
            if rng.random() < 0.9:
                _house(rng, scene, x, width, side, half)
            x += width + rng.choice([0.0, 0.0, 2.5])
    _furniture(rng, scene, length, half)
    return scene.build(), half


def facade(rng: Generator) -> Scene:
    """One house front with its relief, facing -y."""
    scene = SceneBuilder()
    _house(rng, scene, -6.0, 12.0, 1.0, 0.0)
    return scene.build()


def _ground(rng: Generator, scene: SceneBuilder, length: float, half: float) -> None:
    """Add a cambered road between kerbs and pavements."""
    bumps, kerb, road = SmoothField(rng, 3.0, 2), rng.uniform(0.08, 0.15), half - rng.uniform(1.8, 2.6)

    def height(x: Floats, y: Floats) -> Floats:
        relief = 0.008 * bumps(np.stack([x.ravel(), y.ravel()], 1)).reshape(x.shape)
        camber = -0.02 * np.abs(y)
        pavement = np.clip((np.abs(y) - road) / 0.02, 0, 1)
        return np.asarray(relief + camber + kerb * pavement)

    edge = np.array([road, road + 0.02])
    ys = np.unique(np.concatenate([np.linspace(-half - 1, half + 1, 40), edge, -edge]))
    scene.add("ground", height_field(np.linspace(-length / 2 - 2, length / 2 + 2, 120), ys, height))


def _house(rng: Generator, scene: SceneBuilder, x: float, width: float, side: float, half: float) -> None:
    """Add a house front of piers and bands, windows set back, sills, cornice, balconies, a downpipe."""
    storeys, bays = int(rng.integers(2, 5)), max(2, int(width / rng.uniform(2.0, 3.0)))
    storey, depth, back = rng.uniform(2.8, 3.4), rng.uniform(0.12, 0.3), half + rng.uniform(0, 0.4)
    pitch, base = width / bays, 0.0

    def front(low: tuple[float, float, float], high: tuple[float, float, float]) -> Mesh:
        """Return a box in (along, outwards from the front, up), turned to its side of the street."""
        (x0, y0, z0), (x1, y1, z1) = low, high
        ends = sorted((side * (back - y0), side * (back - y1)))
        return box([x + x0, ends[0], z0], [x + x1, ends[1], z1])

    open_width, open_height = pitch * rng.uniform(0.4, 0.6), storey * rng.uniform(0.45, 0.65)
    low = storey * 0.28
    scene.add("facade", front((0, -0.8, -1.0), (width, -0.5, storeys * storey + 0.6)))
    for level in range(storeys):
        base = level * storey
        scene.add("facade", front((0, -0.5, base - (level == 0)), (width, 0, base + low)))
        scene.add("facade", front((0, -0.5, base + low + open_height), (width, 0, base + storey)))
        for bay in range(bays):
            left = bay * pitch + (pitch - open_width) / 2
            scene.add("facade", front((bay * pitch, -0.5, base + low), (left, 0, base + low + open_height)))
            scene.add(
                "facade", front((left + open_width, -0.5, base + low), ((bay + 1) * pitch, 0, base + low + open_height))
            )
            pane = front((left, -depth - 0.02, base + low), (left + open_width, -depth, base + low + open_height))
            scene.add("window", pane)
            sill = front((left - 0.05, 0, base + low - 0.05), (left + open_width + 0.05, 0.12, base + low))
            scene.add("sill", sill, thin=True)
            bar = left + open_width / 2
            scene.add(
                "bar",
                front((bar - 0.025, -depth, base + low), (bar + 0.025, -depth + 0.05, base + low + open_height)),
                thin=True,
            )
            if level and rng.random() < 0.15:
                _balcony(scene, front, left, open_width, base + low * 0.2)
    top = storeys * storey
    scene.add("cornice", front((-0.1, -0.5, top), (width + 0.1, 0.35, top + 0.2)))
    scene.add("facade", front((0, -0.5, top + 0.2), (width, -0.1, top + 0.6)))
    pipe = x + width - 0.15
    scene.add(
        "downpipe", tube([[pipe, side * (back - 0.12), 0], [pipe, side * (back - 0.12), top]], 0.05, 16), thin=True
    )


def _balcony(scene: SceneBuilder, front: object, left: float, width: float, z: float) -> None:
    assert callable(front)
    scene.add("balcony", front((left - 0.2, 0, z), (left + width + 0.2, 0.9, z + 0.12)))
    for bar in np.arange(left - 0.18, left + width + 0.2, 0.12):
        scene.add("railing", front((bar - 0.008, 0.86, z + 0.12), (bar + 0.008, 0.876, z + 1.05)), thin=True)
    scene.add("railing", front((left - 0.2, 0.85, z + 1.05), (left + width + 0.2, 0.89, z + 1.09)), thin=True)


def _furniture(rng: Generator, scene: SceneBuilder, length: float, half: float) -> None:
    kerb = half - 1.6
    poles = np.arange(-length / 2 + rng.uniform(2, 6), length / 2, rng.uniform(14, 22))
    side = rng.choice([-1.0, 1.0])
    for x in poles:
        _lamp_post(rng, scene, np.array([x, side * kerb, -0.1]), side)
    wires = [np.array([x, side * kerb, 7.5]) for x in poles]
    for start, end in pairwise(wires):
        for offset in (-0.3, 0.3):
            shift = np.array([0, offset, 0])
            scene.add(
                "wire",
                tube(sagging(start + shift, end + shift, rng.uniform(0.2, 0.8)), rng.uniform(0.004, 0.012), 8),
                thin=True,
            )
    for x in rng.uniform(-length / 2, length / 2, 2):
        scene.add("wire", tube(sagging([x, -half, 6.5], [x, half, 6.5], 0.3), 0.006, 8), thin=True)
    for x in rng.uniform(-length / 2 + 3, length / 2 - 3, int(rng.integers(2, 5))):
        _tree(rng, scene, np.array([x, -side * kerb, -0.1]))
    for x in rng.uniform(-length / 2 + 4, length / 2 - 4, int(rng.integers(2, 6))):
        _car(rng, scene, np.array([x, rng.choice([-1.0, 1.0]) * (kerb - 1.8), -0.08]))
    for x in rng.uniform(-length / 2 + 4, length / 2 - 4, 3):
        _sign(rng, scene, np.array([x, -side * (kerb + 0.2), -0.1]))


def _lamp_post(rng: Generator, scene: SceneBuilder, at: Floats, side: float) -> None:
    high = rng.uniform(7.6, 8.2)
    scene.add(
        "pole", tube(at + np.array([[0, 0, 0], [0, 0, high * 0.5], [0, 0, high]]), [0.09, 0.07, 0.05], 20), thin=True
    )
    arm = at + np.array([[0, 0, high - 0.2], [0, -side * 0.8, high + 0.1], [0, -side * 1.6, high + 0.15]])
    scene.add("pole", tube(arm, 0.03, 12), thin=True)
    scene.add("lantern", sphere(at + [0, -side * 1.7, high + 0.12], [0.18, 0.3, 0.09], 12))
    scene.add("pole", box(at + [-0.02, -0.4, high - 0.45], at + [0.02, 0.4, high - 0.4]), thin=True)


def _sign(rng: Generator, scene: SceneBuilder, at: Floats) -> None:
    scene.add("post", cylinder(at, 2.6, 0.03, 16), thin=True)
    scene.add("sign", turned(box(at + [-0.3, 0.03, 1.9], at + [0.3, 0.034, 2.5]), rng.uniform(0, 3), at), thin=True)


def _tree(rng: Generator, scene: SceneBuilder, at: Floats) -> None:
    high, reach = rng.uniform(2.0, 3.5), rng.uniform(1.2, 2.2)
    bend = np.cumsum(rng.normal(0, 0.05, (6, 3)) * [1, 1, 0], axis=0)
    trunk = at + bend + np.linspace(0, high, 6)[:, None] * np.array([0, 0, 1.0])
    scene.add("trunk", tube(trunk, np.linspace(0.2, 0.12, 6), 20))
    for _ in range(int(rng.integers(6, 12))):
        start, way = trunk[int(rng.integers(3, 6))], rng.normal(size=3) + [0, 0, 1.2]
        way *= reach * rng.uniform(0.6, 1.1) / np.linalg.norm(way)
        path = start + np.linspace(0, 1, 6)[:, None] * way + rng.normal(0, 0.04, (6, 3)) * np.linspace(0, 1, 6)[:, None]
        scene.add("branch", tube(path, np.linspace(0.05, 0.015, 6), 10), thin=True)
    crown = trunk[-1] + [0, 0, reach * 0.7]
    scene.add("leaves", leaves(rng, crown, [reach, reach, reach * 0.9], 2500, 0.06), loose=True)


def _car(rng: Generator, scene: SceneBuilder, at: Floats) -> None:
    """Add a body with a cabin and four wheels."""
    length, width, waist, roof = rng.uniform(3.8, 4.8), 1.75, rng.uniform(0.8, 0.95), rng.uniform(1.4, 1.6)
    lower = at + np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]]) * [length, width, 0]
    body = hexahedron(lower + [0, 0, 0.2], lower * [1, 1, 0] + [0, 0, at[2] + waist])
    cabin_low = at + np.array([[-0.45, -0.48, 0], [0.2, -0.48, 0], [0.2, 0.48, 0], [-0.45, 0.48, 0]]) * [
        length,
        width,
        0,
    ]
    inset = np.array([[0.25, 0.1, 0], [-0.6, 0.1, 0], [-0.6, -0.1, 0], [0.25, -0.1, 0]])
    cabin = hexahedron(cabin_low + [0, 0, waist], cabin_low + inset + [0, 0, roof])
    scene.add("car", body, cabin)
    for x in (-0.32, 0.32):
        for y in (-0.5, 0.5):
            hub = at + [x * length, y * width, 0.3]
            scene.add("car", tube([hub - [0, 0.09, 0], hub + [0, 0.09, 0]], 0.3, 32))
