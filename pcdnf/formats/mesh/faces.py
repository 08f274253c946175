"""A mesh as its file holds it, and its faces as an element of a PLY."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError
from ..flavours import Block, PlyFlavour

_SHORT = 255
"""Corners that a list with a length of 8 bits holds."""


@dataclass
class Mesh:
    """Vertices and faces.

    Attributes
    ----------
    points : (N, 3) float32 or float64 array
    corners : (C,) int64 array
        The vertices of all faces, face after face, counted from 0.
    sizes : (F,) int64 array
        Corners of each face.
    normals : (N, 3) array or None
    colours : (N, 3) array or None
    comments : list of str
    left_out : list of str
        What the file has besides.
    """

    points: NDArray[Any]
    corners: NDArray[np.int64]
    sizes: NDArray[np.int64]
    normals: NDArray[Any] | None = None
    colours: NDArray[Any] | None = None
    comments: list[str] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)


def as_ply(mesh: Mesh) -> PlyFlavour:
    """Return the flavour of a PLY that holds the faces of a mesh.

    Raises
    ------
    FormatError
        ``bad_value`` for a corner that is no vertex.
    """
    wrong = np.flatnonzero((mesh.corners < 0) | (mesh.corners >= len(mesh.points)))
    if wrong.size:
        face = int(np.searchsorted(np.cumsum(mesh.sizes), wrong[0], side="right"))
        bad_value(f"Face {face} has a corner that is not one of the {len(mesh.points)} vertices")
    if not len(mesh.sizes):
        return PlyFlavour()
    length = "uchar" if int(mesh.sizes.max()) <= _SHORT else "int"
    lines = (f"element face {len(mesh.sizes)}", f"property list {length} int vertex_indices")
    return PlyFlavour(after=(Block("face", lines, _body(mesh, "u1" if length == "uchar" else "<i4")),))


def _body(mesh: Mesh, length: str) -> bytes:
    """Return the rows of the faces: the number of corners, then the corners."""
    corners = mesh.corners.astype("<i4")
    size = int(mesh.sizes[0])
    if (mesh.sizes == size).all():
        rows = np.empty(len(mesh.sizes), [("size", length), ("corners", "<i4", (size,))])
        rows["size"], rows["corners"] = size, corners.reshape(-1, size)
        return rows.tobytes()
    lengths = mesh.sizes.astype(length)
    stops = np.cumsum(mesh.sizes).tolist()
    return b"".join(
        lengths[face].tobytes() + corners[stop - size : stop].tobytes()
        for face, (stop, size) in enumerate(zip(stops, mesh.sizes.tolist(), strict=True))
    )


def numbers_of(words: list[bytes], width: int, what: str) -> NDArray[np.float64]:
    """Words as numbers, (rows, width).

    Raises
    ------
    FormatError
        ``bad_value``.
    """
    try:
        values = np.array([float(word) for word in words])
    except ValueError:
        values = np.empty(0)
    if len(values) != len(words) or any(b"_" in word for word in words):
        bad_value(f"{what} hold words that are not numbers")
    return values.reshape(-1, width)


def bad_value(what: str) -> NoReturn:
    """Raise ``bad_value`` for a mesh."""
    raise FormatError(f"{what}.", code="bad_value", hint="Export the mesh again, preferably as PLY.")
