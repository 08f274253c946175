"""Machine parts in millimetres: a base with bosses, ribs, holes, steps and pins, by constructive solid geometry."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.random import Generator

from ...errors import PcdnfError
from ..scene import Floats, Mesh, Scene, SceneBuilder

ROUND = 128
"""Segments of a full circle."""


def part(rng: Generator) -> Scene:
    """Return a part of 60 to 160 mm.

    Raises
    ------
    PcdnfError
        ``missing_extra`` without manifold3d.
    """
    try:
        solid = importlib.import_module("manifold3d").Manifold
    except ImportError as error:
        raise PcdnfError(
            f"Machine parts cannot be made: {error.name} is not installed.",
            code="missing_extra",
            hint="Run: pip install 'pcdnf[scanners]'",
        ) from error
    length, width = rng.uniform(60, 120), rng.uniform(40, 90)
    high = rng.uniform(6, 18)
    base = _base(rng, solid, length, width, high)
    features: list[tuple[str, Any]] = []
    makers: list[Callable[..., tuple[str, Any]]] = [_boss, _rib, _pin, _step, _wedge, _dome]
    for _ in range(int(rng.integers(4, 9))):
        place = rng.uniform(-0.36, 0.36, 2) * [length, width]
        features.append(makers[int(rng.integers(len(makers)))](rng, solid, place, high))
    holes = [
        solid.cylinder(200, rng.uniform(2, 8), -1, ROUND, True).translate(
            (*(rng.uniform(-0.4, 0.4, 2) * [length, width]), 0)
        )
        for _ in range(int(rng.integers(1, 5)))
    ]
    scene, taken = SceneBuilder(), base
    for hole in holes:
        taken = taken - hole
    scene.add("base", _mesh(taken))
    for name, feature in features:
        grown = feature - taken  # only what stands out of what is there already
        if not grown.is_empty():
            scene.add(name, _mesh(grown), thin=name in ("rib", "pin"))
            taken = taken + feature
    return _outside(scene.build(), _mesh(taken))


def _outside(parts: Scene, union: Mesh) -> Scene:
    """Return the surface of the union, whose faces take the part nearest to them: no walls inside of the body."""
    from ..surface import Surface

    vertices, faces = union
    middles = vertices[faces].mean(1)
    nearest = Surface(parts).nearest(middles)
    return Scene(vertices, faces, parts.face_part[nearest.face], parts.part_names, parts.thin, parts.loose)


def _base(rng: Generator, solid: Any, length: float, width: float, high: float) -> Any:
    if rng.random() < 0.5:
        base = solid.cube((length, width, high), True)
    else:
        base = solid.cylinder(high, width / 2, -1, ROUND, True) + solid.cube((length, width * 0.6, high), True)
    base = base.translate((0, 0, high / 2))
    if rng.random() < 0.5:  # an angle bracket
        wall = rng.uniform(3, 8)
        upright = solid.cube((wall, width * 0.6, rng.uniform(25, 60)), True)
        base = base + upright.translate((length * 0.4, 0, high + 10))
    return base


def _boss(rng: Generator, solid: Any, place: Floats, high: float) -> tuple[str, Any]:
    outer, tall = rng.uniform(6, 14), rng.uniform(8, 30)
    ring = solid.cylinder(tall, outer, outer * rng.uniform(0.8, 1), ROUND)
    bore = solid.cylinder(tall + 1, outer * rng.uniform(0.3, 0.7), -1, ROUND)
    return "boss", (ring - bore).translate((*place, high - 0.5))


def _rib(rng: Generator, solid: Any, place: Floats, high: float) -> tuple[str, Any]:
    web = solid.cube((rng.uniform(20, 45), rng.uniform(1.2, 3.5), rng.uniform(10, 35)), True)
    return "rib", web.rotate((0, 0, rng.uniform(0, 180))).translate((*place, high + 4))


def _pin(rng: Generator, solid: Any, place: Floats, high: float) -> tuple[str, Any]:
    pin = solid.cylinder(rng.uniform(10, 30), rng.uniform(0.8, 2.5), -1, 48)
    return "pin", pin.translate((*place, high - 0.5))


def _step(rng: Generator, solid: Any, place: Floats, high: float) -> tuple[str, Any]:
    block = solid.cube((*rng.uniform(10, 30, 2), rng.uniform(2, 14)), True)
    return "step", block.rotate((0, 0, float(rng.choice([0, 30, 45])))).translate((*place, high))


def _wedge(rng: Generator, solid: Any, place: Floats, high: float) -> tuple[str, Any]:
    block = solid.cube((*rng.uniform(12, 30, 2), rng.uniform(8, 20)), True)
    return "wedge", block.rotate((rng.uniform(-35, 35), rng.uniform(-35, 35), 0)).translate((*place, high))


def _dome(rng: Generator, solid: Any, place: Floats, high: float) -> tuple[str, Any]:
    return "dome", solid.sphere(rng.uniform(6, 16), ROUND).translate((*place, high))


def _mesh(solid: Any) -> Mesh:
    mesh = solid.to_mesh()
    return np.asarray(mesh.vert_properties[:, :3], np.float64), np.asarray(mesh.tri_verts, np.int64)
