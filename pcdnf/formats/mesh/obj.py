"""Wavefront OBJ: vertices, colours behind them as many programs write them, and polygons."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..limits import Limits, check_count
from .faces import Mesh, bad_value, numbers_of

_BESIDES = {
    b"vt": "texture coordinates",
    b"mtllib": "materials",
    b"usemtl": "materials",
    b"o": "groups",
    b"g": "groups",
    b"s": "smoothing groups",
    b"l": "lines",
    b"p": "points",
    b"curv": "curves",
    b"surf": "surfaces",
}
_WIDTHS = (3, 4, 6, 7)
"""Values of a vertex: x y z, then a weight, or a colour, or both."""


def parse_obj(data: bytes, limits: Limits) -> Mesh:
    """Read the mesh of an OBJ.

    Raises
    ------
    FormatError
        ``bad_value`` or ``too_many_points``.
    """
    vertices: list[bytes] = []
    normals: list[bytes] = []
    width = count = 0
    corners: list[int] = []
    pairs_agree = True
    sizes: list[int] = []
    comments: list[str] = []
    besides: dict[str, None] = {}
    for line in data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines():
        words = line.split()
        keyword = words[0] if words else b""
        if keyword == b"v":
            width = width or len(words) - 1
            if len(words) - 1 != width or width not in _WIDTHS:
                bad_value(f"Vertex {count} has {len(words) - 1} values, where 3 or, with a colour, 6 are expected")
            vertices += words[1:]
            count += 1
        elif keyword == b"vn" and len(words) == 4:
            normals += words[1:]
        elif keyword == b"f":
            indices, alike = _corners(words[1:], count, len(sizes))
            corners += indices
            sizes.append(len(indices))
            pairs_agree &= alike
        elif line.startswith(b"#"):
            comments.append(line[1:].strip().decode("utf-8", "replace"))
        elif keyword in _BESIDES:
            besides[_BESIDES[keyword]] = None
    check_count(count, limits)
    table = numbers_of(vertices, width or 3, "The vertices")
    of_vertices = pairs_agree and len(normals) == 3 * count
    if normals and not of_vertices:
        besides["normals of corners"] = None
    return Mesh(
        np.ascontiguousarray(table[:, :3]),
        np.array(corners, np.int64),
        np.array(sizes, np.int64),
        normals=numbers_of(normals, 3, "The normals") if of_vertices else None,
        colours=_colours(table[:, -3:]) if width >= 6 else None,
        comments=[comment for comment in comments if comment],
        left_out=list(besides),
    )


def _corners(words: list[bytes], count: int, face: int) -> tuple[list[int], bool]:
    """Return the vertices of a face from 0, and whether its normals have the numbers of its vertices."""
    found, alike = [], True
    for word in words:
        first, *rest = word.split(b"/")
        try:
            number = int(first)
        except ValueError:
            bad_value(f"Face {face} has a corner that is not a number")
        alike &= len(rest) < 2 or rest[1] in (first, b"")
        found.append(number - 1 if number > 0 else count + number)
    if len(found) < 3:
        bad_value(f"Face {face} has {len(found)} corners")
    return found, alike


def _colours(values: NDArray[np.float64]) -> NDArray[np.uint8] | NDArray[np.float32]:
    """Colours of 8 bits where they are whole numbers up to 255, else float32."""
    if (values == np.rint(values)).all() and values.min() >= 0 and 1 < values.max() <= 255:
        return values.astype(np.uint8)
    return values.astype(np.float32)
