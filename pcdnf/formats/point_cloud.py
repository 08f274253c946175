"""A point cloud as a file carries it, the limits a file is read under, and the checks on its numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from .errors import FormatError
from .flavours import E57Flavour, LasFlavour, NpzFlavour, PcdFlavour, PlyFlavour, XyzFlavour
from .limits import FLOATS, Array, Limits, check_enough, check_extent

Flavour = PlyFlavour | NpzFlavour | PcdFlavour | XyzFlavour | LasFlavour | E57Flavour


@dataclass(kw_only=True)
class PointCloud:
    """Points and everything their file carried with them.

    Attributes
    ----------
    points : (N, 3) float32 or float64 array
        Coordinates, in the file's unit.
    normals : (N, 3) float32 or float64 array or None
        Normals as stored: not necessarily of unit length.
    attributes : dict of str to (N, ...) array
        Every other per-point column, in file order, with its type.
    extras : dict of str to array
        NPZ members that are not per point.
    comments, obj_info : list of str
        Header lines of a PLY; our own metadata is not among them.
    metadata : dict of str to str
        What an earlier denoising recorded (PLY comments ``pcdnf <key>: <value>``, NPZ ``pcdnf_<key>``).
    flavour : Flavour
        How it was stored, one of the classes of ``flavours.py``, so that it can go back the same way.
    warnings : list of str
        Sentences on what was skipped or converted while reading.
    dropped : (D,) int64 array
        Rows of the file that were left out: NaN or infinity, or outliers.
    """

    points: Array
    normals: Array | None = None
    attributes: dict[str, Array] = field(default_factory=dict)
    extras: dict[str, Array] = field(default_factory=dict)
    comments: list[str] = field(default_factory=list)
    obj_info: list[str] = field(default_factory=list)
    metadata: dict[str, str] = field(default_factory=dict)
    flavour: Flavour = field(default_factory=PlyFlavour)
    warnings: list[str] = field(default_factory=list)
    dropped: Array = field(default_factory=lambda: np.empty(0, np.int64))

    def __post_init__(self) -> None:
        for array in (self.points, self.normals):
            if array is not None and (array.ndim != 2 or array.shape[1] != 3 or array.dtype not in FLOATS):
                raise ValueError(f"expected (N, 3) float32 or float64, not {array.dtype} {array.shape}")
        if self.normals is not None and self.normals.shape != self.points.shape:
            raise ValueError(f"normals {self.normals.shape} do not match points {self.points.shape}")
        for name, column in self.attributes.items():
            if len(column) != len(self.points):
                raise ValueError(f"attribute {name!r} has {len(column)} rows, not {len(self.points)}")

    def __len__(self) -> int:
        return len(self.points)

    def without(self, rows: Array, why: str) -> PointCloud:
        """The cloud without some rows, which ``dropped`` and a warning name by their numbers in the file.

        Parameters
        ----------
        rows : (D,) int array
            Of this cloud, ascending.
        why : str
            What the warning says of them, such as "Outliers".
        """
        keep = np.ones(len(self), bool)
        keep[rows] = False
        in_file = np.setdiff1d(np.arange(len(self) + len(self.dropped)), self.dropped)[rows]
        return replace(
            self,
            points=self.points[keep],
            normals=None if self.normals is None else self.normals[keep],
            attributes={name: column[keep] for name, column in self.attributes.items()},
            dropped=np.union1d(self.dropped, in_file),
            warnings=[*self.warnings, f"{why} were left out: {row_ranges(in_file)}."],
        )

    def replaced(
        self, points: ArrayLike, normals: ArrayLike | None, *, metadata: Mapping[str, str] | None = None
    ) -> PointCloud:
        """The same cloud with new coordinates and normals.

        Parameters
        ----------
        points : (N, 3) array_like
            New coordinates, in the order of the old ones; stored in their type.
        normals : (N, 3) array_like or None
            New normals, stored in the type of the file's, or of the coordinates; None keeps the old.
        metadata : mapping of str to str, optional
            Replaces all recorded metadata, so that results of results do not pile it up.
        """
        known = self.points.dtype if self.normals is None else self.normals.dtype
        recorded = dict(self.metadata if metadata is None else metadata)
        if metadata is not None and self.dropped.size:
            recorded["dropped_rows"] = row_ranges(self.dropped)
        return replace(
            self,
            points=np.asarray(points, self.points.dtype),
            normals=self.normals if normals is None else np.asarray(normals, known),
            metadata=recorded,
        )


def row_ranges(rows: Array, width: int = 400) -> str:
    """Sorted row numbers as text: ``"3, 17-20 (5 rows)"``; at most about ``width`` characters of ranges."""
    breaks = np.flatnonzero(np.diff(rows) != 1)
    firsts = rows[np.concatenate([[0], breaks + 1])]
    lasts = rows[np.concatenate([breaks, [len(rows) - 1]])]
    parts: list[str] = []
    length = 0
    for first, last in zip(firsts.tolist(), lasts.tolist(), strict=True):
        part = str(first) if first == last else f"{first}-{last}"
        length += len(part) + 2
        if length > width:
            parts.append("…")
            break
        parts.append(part)
    return f"{', '.join(parts)} ({len(rows)} row{'s' if len(rows) != 1 else ''})"


def checked(cloud: PointCloud, limits: Limits) -> PointCloud:
    """The cloud if its numbers can be worked on: enough points, finite, of a sane extent.

    Raises
    ------
    FormatError
        ``too_few_points``, ``nonfinite``, ``zero_extent``, ``extent_out_of_range``.
    """
    check_enough(len(cloud), limits)
    finite: Array = np.asarray(np.isfinite(cloud.points).all(axis=1))
    if cloud.normals is not None:
        finite = finite & np.isfinite(cloud.normals).all(axis=1)
    if not finite.all():
        cloud = _without_nonfinite(cloud, finite, limits)
    check_extent(cloud.points)
    return cloud


def _without_nonfinite(cloud: PointCloud, finite: Array, limits: Limits) -> PointCloud:
    bad = np.flatnonzero(~finite)
    if limits.nonfinite == "reject":
        raise FormatError(
            f"{len(bad)} of {len(cloud)} points have NaN or infinity in their coordinates or normals; "
            f"the first is row {bad[0]} (counted from 0).",
            code="nonfinite",
            hint="Remove these rows, or ask for nonfinite=drop to have them left out.",
            limit=0,
            actual=len(bad),
        )
    check_enough(int(finite.sum()), limits)
    return cloud.without(bad, "Rows with NaN or infinity")
