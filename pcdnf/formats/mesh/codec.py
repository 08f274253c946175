"""Meshes of other formats: OBJ, OFF and STL. Their vertices are a cloud, whose results are PLY with the same faces."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..limits import Limits, check_count, check_enough
from ..point_cloud import PointCloud, checked
from .faces import Mesh, as_ply
from .obj import parse_obj
from .off import parse_off
from .stl import FACET, STL_HEAD, parse_binary_stl, parse_text_stl

HEAD_BYTES = 4096
"""Of a file, by which a mesh is recognised."""

_OFF = re.compile(rb"(C|N|CN|NC)?OFF\s+(?!BINARY)")
_OBJ = re.compile(rb"(?:[ \t]*(?:#[^\n]*|\r?)\n)*(?:v|vn|vt|o|g|s|mtllib|usemtl)[ \t]")
_OBJ_VERTEX = re.compile(rb"^v[ \t]+[-+.0-9]", re.MULTILINE)

_PARSERS: dict[str, Callable[[bytes, Limits], Mesh]] = {
    "OBJ": parse_obj,
    "OFF": parse_off,
    "STL": parse_text_stl,
    "binary STL": parse_binary_stl,
}


def mesh_kind(head: bytes, size: int) -> str | None:
    """Return the kind of mesh in a file of `size` bytes by its first :data:`HEAD_BYTES`; None for other files."""
    if len(head) >= STL_HEAD and STL_HEAD + FACET.itemsize * struct.unpack_from("<I", head, STL_HEAD - 4)[0] == size:
        return "binary STL"
    if head.startswith(b"solid") and b"facet" in head:
        return "STL"
    if _OFF.match(head):
        return "OFF"
    return "OBJ" if _OBJ.match(head) and _OBJ_VERTEX.search(head) and b"\0" not in head else None


def read_mesh(file: BinaryIO, kind: str, limits: Limits) -> PointCloud:
    """Read the vertices of a mesh; its faces become those of a PLY.

    Parameters
    ----------
    file : binary file
        Open at its first byte.
    kind : str
        As :func:`mesh_kind` returns it.
    limits : Limits
        Bounds on points, and what to do with rows that are not finite.

    Raises
    ------
    FormatError
        With the code of what is wrong.
    """
    mesh = _PARSERS[kind](file.read(), limits)
    count = len(mesh.points)
    check_count(count, limits)
    check_enough(count, limits)
    flavour = as_ply(mesh)
    warnings = [f"The file is an {kind.removeprefix('binary ')} mesh; results are PLY, with its faces unchanged."]
    if mesh.left_out:
        warnings.append(f"Left out were: {', '.join(mesh.left_out)}.")
    attributes: dict[str, NDArray[Any]] = {}
    if mesh.colours is not None:
        attributes = {name: np.ascontiguousarray(mesh.colours[:, i]) for i, name in enumerate(("red", "green", "blue"))}
    return checked(
        PointCloud(
            points=mesh.points,
            normals=mesh.normals,
            attributes=attributes,
            comments=mesh.comments,
            flavour=flavour,
            warnings=warnings,
        ),
        limits,
    )
