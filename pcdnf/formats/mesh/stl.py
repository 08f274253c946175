"""STL: triangles that repeat their corners. Equal corners become one vertex, in the order of their first use."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..limits import Limits, check_count
from .faces import Mesh, bad_value, numbers_of

STL_HEAD = 84
"""Bytes of a binary STL before its triangles."""
FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("bytes", "<u2")])

_VERTEX = re.compile(rb"^[ \t]*vertex[ \t]+(\S+)[ \t]+(\S+)[ \t]+(\S+)[ \t]*\r?$", re.MULTILINE | re.IGNORECASE)


def parse_binary_stl(data: bytes, limits: Limits) -> Mesh:
    """Read the mesh of a binary STL, whose size agrees with its number of triangles."""
    facets = np.frombuffer(data, FACET, offset=STL_HEAD)
    left_out = ["colours or marks of triangles"] if facets["bytes"].any() else []
    return _joined(facets["corners"].reshape(-1, 3), left_out, limits)


def parse_text_stl(data: bytes, limits: Limits) -> Mesh:
    """Read the mesh of an STL of text.

    Raises
    ------
    FormatError
        ``bad_value`` or ``too_many_points``.
    """
    words = [word for match in _VERTEX.findall(data) for word in match]
    corners = numbers_of(words, 3, "The vertices")
    if len(corners) % 3 or len(corners) != 3 * len(re.findall(rb"(?mi)^[ \t]*facet\b", data)):
        bad_value("The STL has triangles that do not have three vertices")
    return _joined(corners, [], limits)


def _joined(corners: NDArray[Any], left_out: list[str], limits: Limits) -> Mesh:
    """Return the mesh of triangles, (3 F, 3), with equal corners joined."""
    values = np.ascontiguousarray(corners) + 0.0  # -0 and 0 are one place
    keys = values.view(np.dtype((np.void, values.dtype.itemsize * 3)))[:, 0]
    _, first, where = np.unique(keys, return_index=True, return_inverse=True)
    order = np.argsort(first, kind="stable")
    number = np.empty(len(order), np.int64)
    number[order] = np.arange(len(order))
    check_count(len(first), limits)
    return Mesh(
        values[first[order]],
        number[where.reshape(-1)],
        np.full(len(values) // 3, 3),
        left_out=[*left_out, "normals of triangles"],
    )
