"""Pieces of scenes: boxes, tubes, spheres, lathed profiles, height fields, leaves."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from .scene import Floats, Ints, Mesh

_BOX_FACES = np.array(
    [[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7], [0, 1, 5], [0, 5, 4], [1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6]]
    + [[3, 0, 4], [3, 4, 7]]
)
_BOX_CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], float)


def box(low: ArrayLike, high: ArrayLike) -> Mesh:
    """Return a box between two corners, axis-parallel."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    return low + _BOX_CORNERS * (high - low), _BOX_FACES.copy()


def hexahedron(bottom: ArrayLike, top: ArrayLike) -> Mesh:
    """Return a body between two quadrilaterals (4, 3), both counter-clockwise from above."""
    return np.concatenate([np.asarray(bottom, float), np.asarray(top, float)]), _BOX_FACES.copy()


def tube(path: ArrayLike, radius: ArrayLike, sides: int = 12) -> Mesh:
    """Return a closed tube along a path (P, 3); ``radius`` is one number or one for each point of the path."""
    path = np.asarray(path, float)
    reach = np.broadcast_to(np.asarray(radius, float), len(path))
    along = np.gradient(path, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    helper = np.eye(3)[np.abs(along.mean(0)).argmin()]
    side = np.cross(along, helper)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    other = np.cross(along, side)
    angle = np.arange(sides) * 2 * np.pi / sides
    ring = np.cos(angle)[:, None, None] * side + np.sin(angle)[:, None, None] * other  # (sides, P, 3)
    rings = path[:, None] + reach[:, None, None] * ring.transpose(1, 0, 2)
    vertices = np.concatenate([rings.reshape(-1, 3), path[[0]], path[[-1]]])
    faces = _grid_faces(len(path), sides, closed=True)
    turn, last = np.arange(sides), (len(path) - 1) * sides
    after = (turn + 1) % sides
    start = np.stack([np.full(sides, len(vertices) - 2), after, turn], 1)
    end = np.stack([np.full(sides, len(vertices) - 1), last + turn, last + after], 1)
    return vertices, np.concatenate([faces, start, end])


def cylinder(base: ArrayLike, height: float, radius: float, sides: int = 24) -> Mesh:
    """Return an upright cylinder on ``base``."""
    base = np.asarray(base, float)
    return tube(np.stack([base, base + [0, 0, height]]), radius, sides)


def lathe(base: ArrayLike, profile: ArrayLike, sides: int = 48) -> Mesh:
    """Return an upright body of revolution; ``profile`` (P, 2) holds radius and height."""
    profile, base = np.asarray(profile, float), np.asarray(base, float)
    angle = np.arange(sides) * 2 * np.pi / sides
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(sides)], 1)
    rings = base + profile[:, None, :1] * ring + profile[:, None, 1:] * np.array([0, 0, 1.0])
    return rings.reshape(-1, 3), _grid_faces(len(profile), sides, closed=True)


def sphere(centre: ArrayLike, radius: ArrayLike, rings: int = 24) -> Mesh:
    """Return a sphere, or an ellipsoid of three radii."""
    angle = np.linspace(0, np.pi, rings + 1)
    vertices, faces = lathe(np.zeros(3), np.stack([np.sin(angle), -np.cos(angle)], 1), 2 * rings)
    return np.asarray(centre, float) + vertices * np.asarray(radius, float), faces


def height_field(xs: Floats, ys: Floats, height: Callable[[Floats, Floats], Floats]) -> Mesh:
    """Return a surface over a grid; ``height`` takes and returns arrays of one shape."""
    x, y = np.meshgrid(xs, ys, indexing="ij")
    vertices = np.stack([x, y, height(x, y)], -1).reshape(-1, 3)
    return vertices, _grid_faces(len(xs), len(ys), closed=False)[:, ::-1]


def leaves(rng: Generator, centre: ArrayLike, reach: ArrayLike, count: int, size: float) -> Mesh:
    """Single triangles of random direction within an ellipsoid, more of them near its surface."""
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    middle = np.asarray(centre) + direction * rng.uniform(0.2, 1, (count, 1)) ** 0.5 * np.asarray(reach)
    corners = middle[:, None] + rng.normal(0, size, (count, 3, 3))
    return corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)


def sagging(start: ArrayLike, end: ArrayLike, sag: float, points: int = 24) -> Floats:
    """Path (points, 3) of a wire between two ends, a parabola as a taut catenary is."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    share = np.linspace(0, 1, points)[:, None]
    return np.asarray(start + share * (end - start) - 4 * sag * share * (1 - share) * np.array([0, 0, 1.0]))


def turned(mesh: Mesh, yaw: float, about: ArrayLike = (0.0, 0.0, 0.0)) -> Mesh:
    """Return a piece turned about a vertical axis."""
    about = np.asarray(about, float)
    cosine, sine = np.cos(yaw), np.sin(yaw)
    turn = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
    return (mesh[0] - about) @ turn.T + about, mesh[1]


def moved(mesh: Mesh, by: ArrayLike) -> Mesh:
    """Return a piece moved by a vector."""
    return mesh[0] + np.asarray(by, float), mesh[1]


def _grid_faces(rows: int, columns: int, *, closed: bool) -> Ints:
    """Two triangles for each cell of a grid of vertices; ``closed``: the last column meets the first."""
    row = np.arange(rows - 1)[:, None]
    column = np.arange(columns if closed else columns - 1)[None]
    after = (column + 1) % columns
    a, b, c, d = (
        row * columns + column,
        row * columns + after,
        (row + 1) * columns + after,
        (row + 1) * columns + column,
    )
    lower, upper = np.stack([a, b, c], -1), np.stack([a, c, d], -1)
    return np.concatenate([lower.reshape(-1, 3), upper.reshape(-1, 3)])
