"""A point cloud as a file carries it, and the checks on its numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from .errors import FormatError
from .flavours import E57Flavour, LasFlavour, NpzFlavour, PcdFlavour, PlyFlavour, PtxFlavour, XyzFlavour
from .limits import FLOATS, Array, Limits, check_enough, check_extent, finite_rows
from .roles import stale_normals

Flavour = PlyFlavour | NpzFlavour | PcdFlavour | XyzFlavour | LasFlavour | E57Flavour | PtxFlavour


@dataclass(frozen=True)
class Holes:
    """Rows of a file without coordinates, such as the pixels of an organised cloud that saw nothing.

    Attributes
    ----------
    rows : (H,) int64 array
        Their numbers in the file, ascending.
    points : (H, 3) array
        NaN or infinity in each row.
    normals : (H, 3) array or None
    attributes : dict of str to (H, ...) array
    """

    rows: Array
    points: Array
    normals: Array | None
    attributes: dict[str, Array]


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
    holes : Holes or None
        Rows without coordinates, which :meth:`whole` puts back into their places.
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
    holes: Holes | None = None

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

    @property
    def brightest(self) -> float | None:
        """The value of full brightness of the colours, where the file says it."""
        return self.flavour.brightest if isinstance(self.flavour, E57Flavour) else None

    def aside(self, rows: Array, why: str) -> PointCloud:
        """Return the cloud without some rows, (D,) int ascending, which :meth:`whole` puts back."""
        keep = np.ones(len(self), bool)
        keep[rows] = False
        lost, old, numbers = self.only(rows), self.holes, self.file_rows()[rows]
        holes = Holes(numbers, lost.points, lost.normals, lost.attributes)
        if old is not None:
            holes = _joined(old, holes)
        return replace(self.only(keep), holes=holes, warnings=[*self.warnings, why])

    def file_rows(self) -> Array:
        """Return the row of each point in the file, (N,) int64, ascending."""
        absent = self.dropped if self.holes is None else np.union1d(self.dropped, self.holes.rows)
        return np.setdiff1d(np.arange(len(self) + len(absent)), absent)

    def whole(self) -> PointCloud:
        """Return the cloud with its holes in their places, as rows of NaN or infinity."""
        holes = self.holes
        if holes is None:
            return self
        order = np.argsort(np.concatenate([self.file_rows(), holes.rows]), kind="stable")
        normals = self.normals
        if normals is not None:
            absent = np.where(np.isfinite(holes.points).all(axis=1, keepdims=True), 0, np.nan)
            absent = np.broadcast_to(absent, holes.points.shape).astype(normals.dtype)
            normals = np.concatenate([normals, absent if holes.normals is None else holes.normals])[order]
        return replace(
            self,
            points=np.concatenate([self.points, holes.points])[order],
            normals=normals,
            attributes={
                name: np.concatenate([column, holes.attributes[name]])[order]
                for name, column in self.attributes.items()
            },
            holes=None,
        )

    def only(self, rows: Array) -> PointCloud:
        """Return the cloud of some of its rows, (M,) int or bool, in the given order; holes are left out."""
        return replace(
            self,
            points=self.points[rows],
            normals=None if self.normals is None else self.normals[rows],
            attributes={name: column[rows] for name, column in self.attributes.items()},
            holes=None,
        )

    def without(self, rows: Array, why: str) -> PointCloud:
        """Return the cloud without some rows; `dropped` and a warning name them by their numbers in the file.

        Parameters
        ----------
        rows : (D,) int array
            Of this cloud, ascending.
        why : str
            What the warning says of them, such as "Outliers".
        """
        keep = np.ones(len(self), bool)
        keep[rows] = False
        in_file = self.file_rows()[rows]
        return replace(
            self.only(keep),
            dropped=np.union1d(self.dropped, in_file),
            warnings=[*self.warnings, f"{why} were left out: {row_ranges(in_file)}."],
            holes=self.holes,
        )

    def replaced(
        self, points: ArrayLike, normals: ArrayLike | None, *, metadata: Mapping[str, str] | None = None
    ) -> PointCloud:
        """Return the same cloud with new coordinates and normals.

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
        stale = [] if normals is None else stale_normals(self.attributes)
        holes = self.holes
        if stale and holes is not None:
            holes = replace(holes, attributes=_lacking(holes.attributes, stale))
        recorded = dict(self.metadata if metadata is None else metadata)
        if metadata is not None and self.dropped.size:
            recorded["dropped_rows"] = row_ranges(self.dropped)
        return replace(
            self,
            points=np.asarray(points, self.points.dtype),
            normals=self.normals if normals is None else np.asarray(normals, known),
            attributes=_lacking(self.attributes, stale),
            metadata=recorded,
            warnings=[*self.warnings, *([_STALE.format(", ".join(stale))] if stale else [])],
            holes=holes,
        )


def _joined(first: Holes, second: Holes) -> Holes:
    """Two sets of rows that were put aside as one, ascending."""
    order = np.argsort(np.concatenate([first.rows, second.rows]))

    def both(one: Array, other: Array) -> Array:
        joined: Array = np.concatenate([one, other])[order]
        return joined

    return Holes(
        both(first.rows, second.rows),
        both(first.points, second.points),
        None if first.normals is None or second.normals is None else both(first.normals, second.normals),
        {name: both(column, second.attributes[name]) for name, column in first.attributes.items()},
    )


_STALE = "Older normals were left out, since new ones take their place: {}."


def _lacking(columns: dict[str, Array], names: list[str]) -> dict[str, Array]:
    return {name: column for name, column in columns.items() if name not in names} if names else columns


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
    """Return the cloud if its numbers can be used: enough points, finite, of a sensible extent.

    Normals that are missing, zero, NaN or infinite are left to whoever uses them.

    Raises
    ------
    FormatError
        ``too_few_points``, ``nonfinite``, ``zero_extent``, ``extent_out_of_range``.
    """
    check_enough(len(cloud), limits)
    finite = finite_rows(cloud.points)
    if not finite.all():
        cloud = _finite_part(cloud, finite, limits)
    check_extent(cloud.points)
    return cloud


def _finite_part(cloud: PointCloud, finite: Array, limits: Limits) -> PointCloud:
    bad = np.flatnonzero(~finite)
    if limits.nonfinite == "reject":
        raise FormatError(
            f"{len(bad)} of {len(cloud)} points have NaN or infinity in their coordinates; "
            f"the first is row {bad[0]} (counted from 0).",
            code="nonfinite",
            hint="Ask for nonfinite=keep to have these rows come back in their places, or nonfinite=drop to have "
            "them left out.",
            limit=0,
            actual=len(bad),
        )
    check_enough(int(finite.sum()), limits)
    if limits.nonfinite == "drop":
        return cloud.without(bad, "Rows with NaN or infinity")
    lost = cloud.only(bad)
    return replace(
        cloud.only(finite),
        holes=Holes(bad, lost.points, lost.normals, lost.attributes),
        warnings=[
            *cloud.warnings,
            f"{len(bad)} of {len(cloud)} rows have no coordinates (NaN or infinity); they come back in their places.",
        ],
    )
