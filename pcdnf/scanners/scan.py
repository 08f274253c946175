"""A scan with its truth, and its file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import PcdnfError
from .scene import Bools, Floats, Ints, Scene
from .surface import Surface

MIXED = 3.0
"""A point whose noise-free place lies further from any surface than this many standard deviations is mixed."""


@dataclass(frozen=True)
class Scan:
    """What a scanner gives of a scene, and what is true of it.

    Attributes
    ----------
    name, unit : str
    points : ndarray, (N, 3) float64
        As the scanner gives them.
    clean, normals : ndarray, (N, 3) float64
        The true surface point that each belongs to, and its unit normal on the sensor's side.
    sigma : ndarray, (N,) float64
        Standard deviation of a point's error along the ray or normal, registration included.
    mixed : ndarray, (N,) bool
        Mixed or flying pixels, leaves, outliers: no surface point is their truth.
    part, station : ndarray, (N,) int64
        Rows of the scene's parts and of ``sensors``.
    sensors : ndarray, (S, 3) float64
        Where the scanner stood.
    scene : Scene
        The true surface.
    """

    name: str
    unit: str
    points: Floats
    clean: Floats
    normals: Floats
    sigma: Floats
    mixed: Bools
    part: Ints
    station: Ints
    sensors: Floats
    scene: Scene

    @property
    def thin(self) -> Bools:
        """Which points belong to thin parts, (N,)."""
        return np.asarray(self.scene.thin[self.part])

    def rows(self, kept: Ints | Bools) -> Scan:
        """Return the scan of some of the points."""
        return Scan(
            self.name,
            self.unit,
            self.points[kept],
            self.clean[kept],
            self.normals[kept],
            self.sigma[kept],
            self.mixed[kept],
            self.part[kept],
            self.station[kept],
            self.sensors,
            self.scene,
        )


def make_scan(
    name: str,
    unit: str,
    surface: Surface,
    *,
    points: Floats,
    ideal: Floats,
    sigma: Floats,
    station: Ints,
    sensors: Floats,
    outlier: Bools | None = None,
) -> Scan:
    """Complete a scan by what the surface tells.

    Parameters
    ----------
    name, unit : str
    surface : Surface
    points, ideal : ndarray, (N, 3) float64
        With noise, and without noise and registration errors.
    sigma : ndarray, (N,) float64
    station : ndarray, (N,) int64
    sensors : ndarray, (S, 3) float64
    outlier : ndarray, (N,) bool, optional
        Points that are known to belong to no surface.
    """
    truth, scene = surface.nearest(ideal), surface.scene
    normals = surface.normals[truth.face]
    facing = ((sensors[station] - truth.points) * normals).sum(1)
    normals = np.where(facing[:, None] < 0, -normals, normals)
    part = scene.face_part[truth.face]
    mixed = (truth.distance > MIXED * sigma) | scene.loose[part]
    if outlier is not None:
        mixed |= outlier
    return Scan(name, unit, points, truth.points, normals, sigma, mixed, part, station, sensors, scene)


class Returns:
    """What a scanner measured in metres, gathered station by station."""

    def __init__(self) -> None:
        self._parts: list[tuple[Floats, Floats, Floats, Ints]] = []

    def add(self, points: Floats, ideal: Floats, deviation: Floats, error: Floats, station: Ints | int) -> None:
        """Add the points of a station.

        Parameters
        ----------
        points, ideal : ndarray, (N, 3) float64
            With noise and all errors, and without any.
        deviation : ndarray, (N,) float64
            Standard deviation of the noise along the ray.
        error : ndarray, (N, 3) float64
            What the pose's error moved each point by.
        station : ndarray, (N,) int64, or int
        """
        sigma = np.hypot(deviation, np.linalg.norm(error, axis=1) / np.sqrt(3))
        self._parts.append((points, ideal, sigma, np.broadcast_to(station, len(points))))

    def scan(self, name: str, surface: Surface, sensors: Floats) -> Scan:
        """Return them as a scan, completed by what the surface tells; ``sensors`` is (S, 3) float64."""
        points, ideal, sigma, station = (np.concatenate(part) for part in zip(*self._parts, strict=True))
        return make_scan(name, "m", surface, points=points, ideal=ideal, sigma=sigma, station=station, sensors=sensors)


def save_scan(path: Path, scan: Scan) -> None:
    """Write a scan as .npz, with the arrays that :func:`load_scan` reads and more."""
    scene = scan.scene
    np.savez_compressed(
        path,
        points=scan.points,
        clean=scan.clean,
        normals=scan.normals.astype(np.float32),
        sigma=scan.sigma.astype(np.float32),
        mixed=scan.mixed,
        part=scan.part,
        station=scan.station,
        sensors=scan.sensors,
        vertices=scene.vertices,
        faces=scene.faces,
        face_part=scene.face_part,
        part_names=np.array(scene.part_names),
        thin=scene.thin,
        loose=scene.loose,
        unit=np.array(scan.unit),
        name=np.array(scan.name),
    )


def load_scan(path: Path) -> Scan:
    """Read a scan from .npz; true points and normals that are not in it are taken from its mesh.

    Raises
    ------
    PcdnfError
        ``bad_scan`` for a file that lacks what a scan needs.
    """
    try:
        with np.load(path, allow_pickle=False) as arrays:
            values = {key: arrays[key] for key in arrays.files}
        thin = values["thin"].astype(bool)
        scene = Scene(
            values["vertices"].astype(np.float64),
            values["faces"].astype(np.int64),
            values["face_part"].astype(np.int64),
            tuple(str(name) for name in values["part_names"]),
            thin,
            values.get("loose", np.zeros(len(thin), bool)).astype(bool),
        )
        points, mixed = values["points"].astype(np.float64), values["mixed"].astype(bool)
        sigma, part = values["sigma"].astype(np.float64), values["part"].astype(np.int64)
        station, sensors = values["station"].astype(np.int64), values["sensors"].astype(np.float64)
        name, unit = str(values["name"]), str(values["unit"])
    except (KeyError, ValueError, OSError) as error:
        raise PcdnfError(
            f"{path.name} is not a scan with its truth: {error}.",
            code="bad_scan",
            hint="It needs points, sigma, mixed, part, station, sensors, vertices, faces, face_part, thin and names.",
        ) from error
    if "clean" in values and "normals" in values:
        clean, normals = values["clean"].astype(np.float64), values["normals"].astype(np.float64)
    else:
        surface = Surface(scene)
        nearest = surface.nearest(points)
        clean, normals = nearest.points, surface.normals[nearest.face]
    if len(sensors) <= station.max():
        station = np.zeros(len(points), np.int64)
    return Scan(name, unit, points, clean, normals, sigma, mixed, part, station, sensors, scene)
