"""The check of a written file: it is read back and compared with the cloud it was written from."""

from __future__ import annotations

from typing import Any, BinaryIO

import numpy as np

from .codec import Codec
from .coordinates import spacing
from .errors import FormatError
from .limits import Array, Limits, finite_rows
from .point_cloud import PointCloud

SAMPLE = 1000
"""Rows that are compared, evenly spread."""
_NINE_DIGITS = 5e-9  # of float32 as text, which is read as float64


def check_written(file: BinaryIO, size: int, cloud: PointCloud, codec: Codec) -> None:
    """Compare a file with the cloud it was written from: count, bounds, and a sample of rows.

    Parameters
    ----------
    file : seekable binary file
        As ``codec`` wrote it, of ``size`` bytes.
    cloud : PointCloud
        In the order of the file's rows, without holes where the format has no place for them.
    codec : Codec

    Raises
    ------
    FormatError
        ``written_wrong``.
    """
    file.seek(0)
    try:
        again = codec.read(file, size, Limits(minimum_points=1)).whole()
    except FormatError as error:
        raise _wrong(codec, f"it cannot be read ({error})") from error
    if len(again) != len(cloud):
        raise _wrong(codec, f"it has {len(again)} points in place of {len(cloud)}")
    tolerance = _tolerance(cloud.points, codec.rounding, again.points.dtype)
    for what, bound in (("lowest", np.nanmin), ("highest", np.nanmax)):
        with np.errstate(invalid="ignore"):
            if (
                np.abs(_finite(bound(_masked(again.points), axis=0) - bound(_masked(cloud.points), axis=0))).max()
                > tolerance
            ):
                raise _wrong(codec, f"its {what} coordinates are other ones")
    rows = np.linspace(0, len(cloud) - 1, min(SAMPLE, len(cloud))).astype(np.int64)
    if not _alike(again.points[rows], cloud.points[rows], tolerance):
        raise _wrong(codec, "its coordinates are other ones")
    if cloud.normals is not None and again.normals is not None:
        lengths = np.abs(_finite(cloud.normals[rows])).max(initial=1e-30)
        if not _alike(again.normals[rows], cloud.normals[rows], 1e-5 * lengths):
            raise _wrong(codec, "its normals are other ones")
    for name in cloud.attributes.keys() & again.attributes.keys():
        if not _same(again.attributes[name][rows], cloud.attributes[name][rows]):
            raise _wrong(codec, f"its column {name!r} holds other values")


def _wrong(codec: Codec, what: str) -> FormatError:
    other = "as .las, uncompressed" if codec.name == "laz" else "in another format, such as PLY"
    return FormatError(
        f"The result was written and read back, and {what}. It was not kept.",
        code="written_wrong",
        hint=f"Write the result {other}, and report this with the file.",
    )


def _masked(points: Array) -> Array:
    return np.where(np.isfinite(points), points, np.nan)


def _finite(values: Array) -> Array:
    return np.where(np.isfinite(values), values, 0)


def _tolerance(points: Array, rounding: float, stored: np.dtype[Any]) -> float:
    """How far a stored coordinate may be from the one given: by the digits of its type, or the grid of the format."""
    finite = points[finite_rows(points)]
    if not len(finite):
        return 0.0
    digits = 1.2e-7 if stored == np.float32 else _NINE_DIGITS if points.dtype == np.float32 else 1e-14
    return max(rounding * spacing(finite), float(np.abs(finite).max()) * digits)


def _alike(first: Array, second: Array, tolerance: float) -> bool:
    one, other = first.astype(np.float64), second.astype(np.float64)
    finite = np.isfinite(other).all(axis=1)
    if not finite.any():
        return True
    return bool((np.abs(one[finite] - other[finite]) <= tolerance).all())


def _same(first: Array, second: Array) -> bool:
    """Whether a column came back, where it was stored in a type that can hold it."""
    if first.shape != second.shape or first.dtype.kind not in "iuf" or second.dtype.kind not in "iuf":
        return True
    if first.dtype != second.dtype:
        return True
    return bool(np.array_equal(first, second, equal_nan=first.dtype.kind == "f"))
