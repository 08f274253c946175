"""PTX, the text format of terrestrial scanners: scans on grids, each with its pose; points without a return are 0 0 0.

A scan is two lines with its columns and rows, four lines with the scanner's position and axes, a matrix of four lines
that moves its points into the common frame, and one line of x y z intensity, or x y z intensity r g b, for each pixel.
"""

from __future__ import annotations

from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..attributes import numeric_attributes, renamed, with_colours
from ..colours import BYTE, WORD
from ..comments import MAX_LINE_BYTES
from ..errors import shown
from ..flavours import PtxFlavour, PtxScan
from ..header_errors import HeaderErrors
from ..limits import Limits, check_count, check_enough
from ..ply.elements import Element, Property
from ..ply.text import TextBody, write_rows
from ..point_cloud import PointCloud, checked
from ..roles import CHANNELS, SCAN_INDEX

MAX_SCANS = 1000
HEAD_LINES = 10
_WIDTHS = (4, 7)
_ERRORS = HeaderErrors("PTX", "Export the scans again as PTX, or as E57.")
_LOOSE = 1e-3  # of a rotation, as matrices are written with few digits


def read_ptx(file: BinaryIO, size: int, limits: Limits) -> PointCloud:
    """Read the points of all scans, moved by their matrices.

    Parameters
    ----------
    file : seekable binary file
        Open at its first byte.
    size : int
        Bytes of the file.
    limits : Limits
        Bounds on points, and what to do with pixels without a return.

    Raises
    ------
    FormatError
        With the code of what is wrong.
    """
    scans: list[PtxScan] = []
    parts: list[NDArray[np.float64]] = []
    count = 0
    while (scan := _head(file, len(scans))) is not None:
        if len(scans) == MAX_SCANS:
            _ERRORS.wrong(f"it has more than {MAX_SCANS} scans")
        count += scan.columns * scan.rows
        check_count(count, limits)
        if file.tell() + 8 * scan.columns * scan.rows - 1 > size:
            declared = f"scan {len(scans)} declares {scan.columns * scan.rows} points"
            _ERRORS.wrong(f"{declared}, more than the file has room for", code="truncated")
        parts.append(_points(file, scan, len(scans)))
        scans.append(scan)
    check_enough(count, limits)
    widths = {part.shape[1] for part in parts}
    if len(widths) > 1:
        _ERRORS.wrong("some scans have colours and others have none")
    return checked(_cloud(scans, parts), limits)


def _head(file: BinaryIO, number: int) -> PtxScan | None:
    """Read the ten lines before the points of a scan; return None at the end of the file."""
    lines: list[list[str]] = []
    while len(lines) < HEAD_LINES:
        line = file.readline(MAX_LINE_BYTES)
        if not line:
            break
        if line.strip():
            lines.append(line.decode("latin-1").split())
    if not lines:
        return None
    widths = [1, 1, 3, 3, 3, 3, 4, 4, 4, 4]
    if [len(line) for line in lines] != widths or not all(
        line[0].isdecimal() and len(line[0]) < 10 for line in lines[:2]
    ):
        _ERRORS.wrong(f"scan {number} does not begin with columns, rows, a position, three axes and a matrix")
    try:
        values = [[float(word) for word in line] for line in lines[2:]]
    except ValueError:
        _ERRORS.wrong(f"the position or the matrix of scan {number} holds words")
    matrix = np.array(values[4:])
    turn = matrix[:3, :3]
    if not np.isfinite(matrix).all() or np.abs(turn @ turn.T - np.eye(3)).max() > _LOOSE:
        _ERRORS.wrong(f"the matrix of scan {number} is not a rotation and a shift")
    return PtxScan(int(lines[0][0]), int(lines[1][0]), tuple(" ".join(line) for line in lines[2:]))


def _points(file: BinaryIO, scan: PtxScan, number: int) -> NDArray[np.float64]:
    """Read the rows of a scan, (columns * rows, 4 or 7)."""
    start = file.tell()
    line = b""
    while not line.strip():
        line = file.readline(MAX_LINE_BYTES)
        if not line:
            _ERRORS.wrong(f"scan {number} has no points", code="truncated")
    width = len(line.split())
    if width not in _WIDTHS:
        _ERRORS.wrong(f"the rows of scan {number} have {width} values; they may have 4 or 7")
    file.seek(start)
    element = Element(f"scan {number}", scan.columns * scan.rows, [Property(str(i), "double") for i in range(width)])
    body = TextBody(file)
    rows = body.read(element)
    body.rewind()
    return np.stack([rows[str(i)] for i in range(width)], axis=1)


def _cloud(scans: list[PtxScan], parts: list[NDArray[np.float64]]) -> PointCloud:
    placed, sizes = [], [len(part) for part in parts]
    for scan, part in zip(scans, parts, strict=True):
        matrix = scan.matrix()
        moved = part[:, :3] @ matrix[:3] + matrix[3]
        moved[(part[:, :3] == 0).all(axis=1)] = np.nan
        placed.append(moved)
    table = np.concatenate(parts)
    attributes: dict[str, NDArray[Any]] = {"intensity": table[:, 3].astype(np.float32)}
    if table.shape[1] == 7:
        colours = np.clip(np.rint(np.nan_to_num(table[:, 4:])), 0, BYTE).astype(np.uint8)
        attributes |= dict(zip(CHANNELS, np.ascontiguousarray(colours.T), strict=True))
    if len(scans) > 1:
        attributes[SCAN_INDEX] = np.repeat(np.arange(len(scans)), sizes).astype(np.uint16)
    return PointCloud(points=np.concatenate(placed), attributes=attributes, flavour=PtxFlavour(tuple(scans)))


def write_ptx(file: BinaryIO, cloud: PointCloud) -> list[str]:
    """Write a cloud into the scans it came from, each in its own frame, or as one scan of one column.

    Returns
    -------
    list of str
        What could not be carried over.
    """
    attributes, notes = numeric_attributes(cloud, "PTX")
    known = cloud.flavour if isinstance(cloud.flavour, PtxFlavour) else None
    if known is None:
        attributes, told = with_colours(renamed(attributes), BYTE, "PTX", cloud.brightest)
        notes += told
    if cloud.normals is not None:
        notes.append("PTX has no place for normals, so they were left out. PLY, LAZ and E57 have one.")
    if cloud.comments or cloud.obj_info or cloud.metadata:
        notes.append("PTX has no place for comments, so the metadata of the run was left out.")
    places = {"intensity", *CHANNELS, *((SCAN_INDEX,) if known else ())}
    lost = [shown(name) for name in (*attributes, *cloud.extras) if name not in places]
    notes += [f"PTX holds intensity and colours only; left out were: {', '.join(lost)}."] if lost else []
    full = _full_intensity(attributes["intensity"]) if "intensity" in attributes else 1
    notes += [f"PTX has intensities from 0 to 1; those of the cloud were divided by {full:g}."] if full != 1 else []
    scans = known.scans if known else (PtxScan(1, len(cloud)),)
    index = attributes.get(SCAN_INDEX) if known and len(scans) > 1 else None
    for number, scan in enumerate(scans):
        rows = np.arange(len(cloud)) if index is None else np.flatnonzero(index == number)
        if len(rows):
            _write_scan(file, cloud.points[rows], scan, _values(attributes, rows))
    return notes


def _values(attributes: dict[str, NDArray[Any]], rows: NDArray[Any]) -> list[NDArray[Any]]:
    """Intensity from 0 to 1, then colours."""
    intensity = attributes.get("intensity")
    values = np.full(len(rows), 0.5) if intensity is None else intensity[rows] / _full_intensity(intensity)
    colours = [attributes.get(name) for name in CHANNELS]
    return [
        values.astype(np.float32),
        *(column[rows] for column in colours if column is not None and column.dtype == np.uint8),
    ]


def _full_intensity(intensity: NDArray[Any]) -> float:
    """Return the value that stands for full intensity: 1, or the highest of 8 bits, of 16 bits, or of the cloud."""
    top = float(np.max(intensity, where=np.isfinite(intensity), initial=0))
    if intensity.dtype.kind == "f" and top <= 1:
        return 1
    return next(most for most in (BYTE, WORD, top) if top <= most)


def _write_scan(file: BinaryIO, points: NDArray[Any], scan: PtxScan, values: list[NDArray[Any]]) -> None:
    columns, rows = (scan.columns, scan.rows) if scan.columns * scan.rows == len(points) else (1, len(points))
    matrix = scan.matrix()
    local = (points.astype(np.float64) - matrix[3]) @ matrix[:3].T
    seen = np.isfinite(local).all(axis=1)
    local[~seen] = 0
    file.write("".join(f"{line}\n" for line in (columns, rows, *scan.lines)).encode())
    write_rows(file, [*local.T, *values])
