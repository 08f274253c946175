"""OFF, the Object File Format of Geomview: text with vertices, their normals (N) and colours (C), and polygons.

Of a vertex with both, normals come first (CNOFF), as Geomview has it; MeshLab writes colours first, as NCOFF.
"""

from __future__ import annotations

import numpy as np

from ..errors import FormatError
from ..header_errors import HeaderErrors
from ..limits import Limits, check_count
from .faces import Mesh, bad_value, numbers_of

_COUNTS = 3
_ERRORS = HeaderErrors("OFF header", "Export the mesh again as PLY.")


def parse_off(data: bytes, limits: Limits) -> Mesh:
    """Read the mesh of an OFF.

    Raises
    ------
    FormatError
        ``bad_header``, ``bad_value``, ``truncated``, ``trailing_data`` or ``too_many_points``.
    """
    lines, comments = _lines(data)
    head = lines[0]
    kind, counts = head[0], head[1:] or (lines[1] if len(lines) > 1 else [])
    body = lines[1:] if head[1:] else lines[2:]
    if len(counts) not in (2, _COUNTS) or not all(word.isdigit() and len(word) < 12 for word in counts):
        _ERRORS.wrong("its counts must be three whole numbers: vertices, faces, edges")
    vertices, faces = int(counts[0]), int(counts[1])
    check_count(vertices, limits)
    if vertices + faces != len(body):
        raise FormatError(
            f"The OFF declares {vertices} vertices and {faces} faces; it has {len(body)} rows.",
            code="truncated" if vertices + faces > len(body) else "trailing_data",
            hint="Correct the counts, or export the mesh again as PLY.",
            limit=vertices + faces,
            actual=len(body),
        )
    width = len(body[0]) if vertices else 3
    normals = 3 * (b"N" in kind)
    colours = width - 3 - normals
    if any(len(row) != width for row in body[:vertices]) or colours not in ((3, 4) if b"C" in kind else (0,)):
        bad_value(f"The vertices of the {kind.decode()} do not all have the values that its first word declares")
    table = numbers_of([word for row in body[:vertices] for word in row], width, "The vertices")
    normal, shade = (3 + colours, 3) if kind.startswith(b"NC") else (3, 3 + normals)
    corners, sizes, is_coloured = _faces(body[vertices:])
    shades = table[:, shade : shade + 3] if colours else None
    left_out = ["colours of faces"] if is_coloured else []
    return Mesh(
        np.ascontiguousarray(table[:, :3]),
        np.array(corners, np.int64),
        np.array(sizes, np.int64),
        normals=np.ascontiguousarray(table[:, normal : normal + 3]) if normals else None,
        colours=None if shades is None else shades.astype(np.uint8 if _are_bytes(shades) else np.float32),
        comments=comments,
        left_out=[*left_out, *(["alpha"] if colours == 4 else [])],
    )


def _lines(data: bytes) -> tuple[list[list[bytes]], list[str]]:
    """Return the words of each line that is not empty, and the comments."""
    lines, comments = [], []
    for line in data.splitlines():
        text, mark, comment = line.partition(b"#")
        if mark and comment.strip():
            comments.append(comment.strip().decode("utf-8", "replace"))
        if text.strip():
            lines.append(text.split())
    return lines, comments


def _faces(rows: list[list[bytes]]) -> tuple[list[int], list[int], bool]:
    """Corners, sizes, and whether a face has a colour."""
    corners: list[int] = []
    sizes: list[int] = []
    is_coloured = False
    for number, row in enumerate(rows):
        if not row[0].isdigit() or len(row[0]) > 9 or len(row) <= int(row[0]) or int(row[0]) < 1:
            bad_value(f"Face {number} does not begin with the number of its corners")
        size = int(row[0])
        if not all(word.isdigit() and len(word) < 12 for word in row[1 : size + 1]):
            bad_value(f"Face {number} has a corner that is not a vertex")
        corners += map(int, row[1 : size + 1])
        sizes.append(size)
        is_coloured |= len(row) > size + 1
    return corners, sizes, is_coloured


def _are_bytes(shades: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> bool:
    return bool((shades == np.rint(shades)).all() and shades.min() >= 0 and 1 < shades.max() <= 255)
