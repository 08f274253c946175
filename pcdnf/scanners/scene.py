"""A scene: one triangle mesh whose faces belong to named parts."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Mesh = tuple[Floats, Ints]
"""Vertices (V, 3) and faces (F, 3) of one piece."""


@dataclass(frozen=True)
class Scene:
    """The true surface of a scan.

    Attributes
    ----------
    vertices : ndarray, (V, 3) float64
    faces : ndarray, (F, 3) int64
    face_part : ndarray, (F,) int64
        Part of each face.
    part_names : tuple of str
    thin : ndarray, (P,) bool
        Parts that are thin: wires, poles, boards, webs.
    loose : ndarray, (P,) bool
        Parts without a surface worth the name, such as leaves.
    """

    vertices: Floats
    faces: Ints
    face_part: Ints
    part_names: tuple[str, ...]
    thin: Bools
    loose: Bools

    @property
    def triangles(self) -> Floats:
        """Corners of all faces, (F, 3, 3)."""
        return self.vertices[self.faces]

    def face_normals(self) -> Floats:
        """Return unit normals of all faces, (F, 3)."""
        corners = self.triangles
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        return np.asarray(cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-300))

    def face_areas(self) -> Floats:
        """Areas of all faces, (F,)."""
        corners = self.triangles
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        return np.asarray(0.5 * np.linalg.norm(cross, axis=1))


@dataclass
class SceneBuilder:
    """Collects pieces into a scene."""

    _pieces: list[tuple[str, Mesh]] = field(default_factory=list)
    _thin: set[str] = field(default_factory=set)
    _loose: set[str] = field(default_factory=set)

    def add(self, part: str, *meshes: Mesh, thin: bool = False, loose: bool = False) -> None:
        """Add pieces to a part; ``thin`` and ``loose`` hold for the whole part."""
        self._pieces += [(part, mesh) for mesh in meshes]
        if thin:
            self._thin.add(part)
        if loose:
            self._loose.add(part)

    def build(self) -> Scene:
        """All pieces as one mesh; faces without an area are left out."""
        names = tuple(dict.fromkeys(part for part, _ in self._pieces))
        vertices, faces, parts, first = [], [], [], 0
        for part, (corners, triangles) in self._pieces:
            vertices.append(corners)
            faces.append(triangles + first)
            parts.append(np.full(len(triangles), names.index(part)))
            first += len(corners)
        scene = Scene(
            np.concatenate(vertices),
            np.concatenate(faces),
            np.concatenate(parts),
            names,
            np.array([name in self._thin for name in names]),
            np.array([name in self._loose for name in names]),
        )
        area = scene.face_areas()
        kept = area > 1e-12 * area.max()
        return Scene(
            scene.vertices, scene.faces[kept], scene.face_part[kept], scene.part_names, scene.thin, scene.loose
        )
