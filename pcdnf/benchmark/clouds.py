"""Clean clouds: read from files, or made by code where there are none."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from ..errors import PcdnfError
from ..formats.files import read
from .noise import add_noise

Floats = NDArray[np.float64]

SUFFIXES = (".npy", ".npz", ".ply")
FIRST_SEED = 3_000_000
"""Of generated shapes: neither trained on nor validated on."""
_NOISY = re.compile(r"(?P<name>.+)_noise(?P<level>\d+(\.\d+)?)")


@dataclass(frozen=True)
class CleanCloud:
    """A clean cloud and the noisy versions that came with it.

    Attributes
    ----------
    name : str
    points : (N, 3) float64 array
    normals : (N, 3) float64 array or None
        Of any length; PCA stands in where there are none.
    given : dict of float to (N, 3) float64 array
        Noisy versions by level, per cent of the diagonal, index-aligned.
    """

    name: str
    points: Floats
    normals: Floats | None = None
    given: dict[float, Floats] = field(default_factory=dict)

    def noisy(self, level: float, kind: str = "gaussian") -> Floats:
        """Return the noisy version that came with the cloud, or one made by :func:`add_noise`."""
        if kind == "gaussian" and level in self.given:
            return self.given[level]
        return add_noise(self.points, level, kind)

    def digest(self) -> str:
        """SHA-256 of the clean points as float32: what published figures are found by."""
        return hashlib.sha256(np.ascontiguousarray(self.points, "<f4").tobytes()).hexdigest()

    def thinned(self, count: int) -> CleanCloud:
        """Return a random choice of points, the same on every call, in the order of the file."""
        if count >= len(self.points):
            return self
        kept = np.sort(np.random.default_rng(0).choice(len(self.points), count, replace=False))
        return replace(
            self,
            points=self.points[kept],
            normals=None if self.normals is None else self.normals[kept],
            given={level: points[kept] for level, points in self.given.items()},
        )


def read_clouds(paths: Iterable[Path]) -> list[CleanCloud]:
    """Clean clouds from files and folders, by name; ``NAME_noise0.5.*`` belongs to ``NAME`` beside it.

    Raises
    ------
    PcdnfError
        ``no_clouds`` for a path that holds none, ``same_name`` for two of one name, ``bad_shape`` for a noisy
        version that does not belong to its clean cloud, and what the readers raise.
    """
    clouds: dict[str, CleanCloud] = {}
    for path in paths:
        files = sorted(path.iterdir()) if path.is_dir() else [path]
        clean = [file for file in files if file.suffix.lower() in SUFFIXES and not _noise_of(file)]
        if not clean:
            raise PcdnfError(
                f"{path} contains no clean cloud.",
                code="no_clouds",
                hint="Name .npy, .npz or .ply files, or a folder of them; NAME_noise0.5.npy counts as noisy.",
            )
        for file in clean:
            if file.stem in clouds:
                raise PcdnfError(
                    f"Two clouds are named {file.stem}.", code="same_name", hint="Rename one of the files."
                )
            clouds[file.stem] = _read(file)
    return [clouds[name] for name in sorted(clouds)]


def _noise_of(file: Path) -> re.Match[str] | None:
    """Match the name of a noisy version; None if its clean cloud is not in the same folder."""
    found = _NOISY.fullmatch(file.stem)
    beside = found and any(file.with_name(found["name"] + suffix).exists() for suffix in SUFFIXES)
    return found if beside else None


def _read(file: Path) -> CleanCloud:
    cloud = read(file)
    points = cloud.points.astype(np.float64)
    given: dict[float, Floats] = {}
    for other in sorted(file.parent.glob(f"{file.stem}_noise*")):
        found = _noise_of(other)
        if found and found["name"] == file.stem and other.suffix.lower() in SUFFIXES:
            noisy = read(other).points.astype(np.float64)
            if noisy.shape != points.shape:
                raise PcdnfError(
                    f"{other.name} has {len(noisy)} points, but {file.name} has {len(points)}.",
                    code="bad_shape",
                    hint="Both need the same points in the same order; otherwise move the noisy file elsewhere.",
                )
            given[float(found["level"])] = noisy
    normals = None if cloud.normals is None else cloud.normals.astype(np.float64)
    return CleanCloud(file.stem, points, normals, given)


def analytic_clouds(count: int) -> list[CleanCloud]:
    """Four shapes by formula, ``count`` points each, area-uniform, with exact normals: they need no extra."""
    makers: dict[str, Callable[[Generator, int], tuple[Floats, Floats]]] = {
        "block": block,
        "can": _can,
        "knoll": _knoll,
        "ring": _ring,
    }
    return [CleanCloud(name, *make(np.random.default_rng(FIRST_SEED), count)) for name, make in makers.items()]


def generated_clouds(shapes: int, count: int) -> list[CleanCloud]:
    """Shapes of the training's generator, with seeds that no training draws.

    Raises
    ------
    PcdnfError
        ``missing_extra`` without the extra ``train``.
    """
    try:
        from ..training.shapes import random_shape
    except ImportError as error:
        raise PcdnfError(
            f"Shapes cannot be generated: {error.name} is not installed.",
            code="missing_extra",
            hint="Run: pip install 'pcdnf[train]'",
        ) from error
    made = [random_shape(np.random.default_rng(FIRST_SEED + index), count) for index in range(shapes)]
    return [CleanCloud(f"shape-{index}", shape.points, shape.normals) for index, shape in enumerate(made)]


def block(rng: Generator, count: int) -> tuple[Floats, Floats]:
    """Points and normals of a box of sides 1, 0.7 and 0.4: planes, edges, corners."""
    sides = np.array([1.0, 0.7, 0.4])
    area = sides.prod() / sides
    axis = rng.choice(3, count, p=area / area.sum())
    points = rng.uniform(-0.5, 0.5, (count, 3)) * sides
    side = rng.choice([-1.0, 1.0], count)
    rows = np.arange(count)
    points[rows, axis] = side * sides[axis] / 2
    normals = np.zeros((count, 3))
    normals[rows, axis] = side
    return points, normals


def _can(rng: Generator, count: int) -> tuple[Floats, Floats]:
    """Sample a cylinder of radius 0.3 and height 0.8 with its lids: circular edges."""
    radius, height = 0.3, 0.8
    angle = rng.uniform(0, 2 * np.pi, count)
    round_ = np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=1)
    on_lid = rng.random(count) < radius / (radius + height)
    up = rng.choice([-1.0, 1.0], count)
    reach = np.where(on_lid, radius * np.sqrt(rng.random(count)), radius)
    points = round_ * reach[:, None]
    points[:, 2] = np.where(on_lid, up * height / 2, rng.uniform(-height / 2, height / 2, count))
    normals = np.where(on_lid[:, None], np.stack([0 * up, 0 * up, up], axis=1), round_)
    return points, normals


def _knoll(rng: Generator, count: int) -> tuple[Floats, Floats]:
    """Sample a sphere with bumps, ``r = 1 + 0.12 sin 4x sin 4y sin 4z``: smooth, curved both ways.

    Directions are drawn by rejection, so that the density of the points is that of the area.
    """
    points, normals = np.empty((0, 3)), np.empty((0, 3))
    while len(points) < count:
        direction = rng.normal(size=(2 * count, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        sine, cosine = np.sin(4 * direction), np.cos(4 * direction)
        reach = 1 + 0.12 * sine.prod(axis=1)
        slope = 0.48 * cosine * np.roll(sine, 1, axis=1) * np.roll(sine, 2, axis=1)
        slope -= (slope * direction).sum(axis=1, keepdims=True) * direction  # along the sphere
        normal = reach[:, None] * direction - slope
        area = reach * np.linalg.norm(normal, axis=1)  # a patch's, relative to the unit sphere's
        kept = rng.random(len(area)) < area / 1.8
        points = np.concatenate([points, (reach[:, None] * direction)[kept]])
        normals = np.concatenate([normals, (normal / np.linalg.norm(normal, axis=1, keepdims=True))[kept]])
    return points[:count], normals[:count]


def _ring(rng: Generator, count: int) -> tuple[Floats, Floats]:
    """Sample a torus of radii 1 and 0.35."""
    ring, tube = 1.0, 0.35
    around = rng.uniform(0, 2 * np.pi, 3 * count)
    kept = rng.random(3 * count) < (ring + tube * np.cos(around)) / (ring + tube)
    around = around[kept][:count]
    along = rng.uniform(0, 2 * np.pi, len(around))
    flat = np.cos(around)
    normals = np.stack([np.cos(along) * flat, np.sin(along) * flat, np.sin(around)], axis=1)
    centre = ring * np.stack([np.cos(along), np.sin(along), np.zeros(len(along))], axis=1)
    return centre + tube * normals, normals
