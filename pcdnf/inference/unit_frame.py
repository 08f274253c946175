"""The unit frame of a cloud: bounding-box normalisation in float64, and the checks of what is to be denoised."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import PcdnfError
from ..formats.geographic import HINT, looks_geographic
from ..formats.limits import EXTENT_RANGE
from ..geometry.distinct import void_rows

TAIL = 0.005
"""Share of points beyond the box of a frame, at either end of each axis."""


class CloudError(PcdnfError):
    """Points that cannot be denoised."""


def checked_points(points: ArrayLike, fewest: int) -> NDArray[np.float64]:
    """Points (N, 3) in one piece, float64.

    Raises
    ------
    CloudError
        ``bad_shape``, ``too_few_points`` where there are less than ``fewest``, or ``geographic_coordinates``.
    """
    given: NDArray[np.float64] = np.ascontiguousarray(_rows_of_three(points, "Points"), np.float64)
    if len(given) < fewest:
        raise CloudError(
            f"The cloud has {len(given)} points; the network needs at least {fewest}.",
            code="too_few_points",
            hint="Use a denser or larger part of the scan.",
        )
    if looks_geographic(given):
        raise CloudError(
            "The coordinates look like degrees with heights in metres.", code="geographic_coordinates", hint=HINT
        )
    return given


def checked_normals(normals: ArrayLike | None, count: int) -> NDArray[np.floating] | None:
    """Check normals (count, 3); None stays None.

    Raises
    ------
    CloudError
        ``bad_shape``.
    """
    if normals is None:
        return None
    given: NDArray[np.floating] = _rows_of_three(normals, "Normals")
    if len(given) != count:
        raise CloudError(
            f"There are {len(given)} normals for {count} points.",
            code="bad_shape",
            hint="Pass one normal per point, zeros if it is unknown, or no normals at all.",
        )
    return given


def _rows_of_three(values: ArrayLike, what: str) -> NDArray[Any]:
    try:
        given = np.asarray(values)
    except ValueError:  # rows of different lengths
        given = np.empty(0, object)
    if given.ndim != 2 or given.shape[1] != 3 or given.dtype.kind not in "fiu":
        raise CloudError(
            f"{what} must be an array (N, 3) of real numbers, not {given.dtype} {given.shape}.",
            code="bad_shape",
            hint="Pass one row of x, y and z per point.",
        )
    return given


@dataclass(frozen=True)
class UnitFrame:
    """Centre (3,) float64 and diagonal of a cloud: local = (world - centre) / diagonal.

    The box leaves out half a per cent of the points at either end of each axis: the patch radius is a share of
    the object's size, which neither noise nor a far outlier may change.
    """

    centre: NDArray[np.float64]
    diagonal: float

    @classmethod
    def of(cls, points: NDArray[np.floating]) -> UnitFrame:
        """UnitFrame of points (N, 3).

        Raises
        ------
        CloudError
            NaN or infinity, no extent, or one outside 1e-12 to 1e12.
        """
        points = np.asarray(points, np.float64)
        low, high = points.min(0), points.max(0)
        if not np.isfinite(low + high).all():
            raise CloudError(
                "The cloud has coordinates that are NaN or infinite.",
                code="nonfinite",
                hint="Remove those points first.",
            )
        extent = float(np.linalg.norm(high - low))
        if extent == 0:
            raise CloudError(
                "All points of the cloud are identical.", code="zero_extent", hint="Check how the file was written."
            )
        smallest, largest = EXTENT_RANGE
        if not smallest <= extent <= largest:
            raise CloudError(
                f"The cloud's bounding-box diagonal is {extent:.3g}; it must lie between {smallest:g} and {largest:g}.",
                code="extent_out_of_range",
                hint="Change the unit of the coordinates, or remove far outliers.",
            )
        inner_low, inner_high = np.quantile(points[~void_rows(points)], (TAIL, 1 - TAIL), axis=0)
        diagonal = float(np.linalg.norm(inner_high - inner_low))
        if diagonal < extent * 1e-6:  # nearly all points are equal
            return cls(low + (high - low) / 2, extent)
        return cls(inner_low + (inner_high - inner_low) / 2, diagonal)

    def to_local(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """World coordinates (N, 3) to centred ones of diagonal 1."""
        local: NDArray[np.float64] = (points - self.centre) / self.diagonal
        return local

    def to_json(self) -> dict[str, float | list[float]]:
        """Plain values that lose nothing."""
        return {"centre": self.centre.tolist(), "diagonal": self.diagonal}

    @classmethod
    def from_json(cls, values: dict[str, float | list[float]]) -> UnitFrame:
        """Invert :meth:`to_json`."""
        return cls(np.asarray(values["centre"], np.float64), float(np.asarray(values["diagonal"])))
