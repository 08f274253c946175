"""The three measures of point-cloud denoising, in the field's usual units.

Coordinates are divided by the bounding-box diagonal of the clean cloud first, so that values of clouds in
different units compare. p is a denoised point, q a clean one.

- Chamfer distance, x 1e5: ``mean_p min_q |p - q|^2 + mean_q min_p |p - q|^2``. It depends on the number of
  points: never compare values of 20 000 and 100 000 points.
- Point-to-surface distance, x 1e3: ``mean_p min(|<p - q, n_q>|, |p - q|)`` with q nearest to p.
- Normal error, degrees, up to sign, against the normal of the nearest clean point: mean and RMS.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from .errors import PcdnfError
from .geometry.normals import pca_normals

CHAMFER_UNIT = 1e-5
SURFACE_UNIT = 1e-3
CLEAN_NORMAL_NEIGHBOURS = 12
"""k of the PCA that stands in for clean normals that are not given."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Scores:
    """A denoised cloud against the clean one.

    Attributes
    ----------
    chamfer_distance : float
        x 1e5, squared, two-sided sum.
    point_to_surface : float
        x 1e3, unsquared.
    normal_mean, normal_rms : float or None
        Degrees; None where there were no normals to judge.
    points : int
        Number of denoised points.
    """

    chamfer_distance: float
    point_to_surface: float
    normal_mean: float | None
    normal_rms: float | None
    points: int


@dataclass(frozen=True)
class PointErrors:
    """The same, point by point.

    Attributes
    ----------
    surface : (N,) float64 array
        Distance to the surface x 1e3; its mean is the point-to-surface distance.
    angle : (N,) float64 array or None
        Of the normals, degrees; None where there were no normals to judge.
    """

    surface: Floats
    angle: Floats | None


@dataclass(frozen=True)
class _Matched:
    """Both clouds in the clean one's unit, and each point's nearest clean point."""

    points: Floats
    clean: Floats
    distance: Floats
    nearest: NDArray[np.int64]


def chamfer_distance(points: ArrayLike, clean_points: ArrayLike, *, workers: int = -1) -> float:
    """Chamfer distance x 1e5.

    Parameters
    ----------
    points : (N, 3) array_like
    clean_points : (M, 3) array_like
        Its bounding-box diagonal is the unit.
    workers : int
        Threads of the neighbour search; -1 takes all.
    """
    return _chamfer_distance(_matched(points, clean_points, workers), workers)


def point_to_surface(
    points: ArrayLike, clean_points: ArrayLike, clean_normals: ArrayLike | None = None, *, workers: int = -1
) -> float:
    """Point-to-surface distance x 1e3.

    Parameters
    ----------
    points : (N, 3) array_like
    clean_points : (M, 3) array_like
        Its bounding-box diagonal is the unit.
    clean_normals : (M, 3) array_like, optional
        By default PCA normals of the clean cloud, k = 12.
    workers : int
        Threads of the neighbour search; -1 takes all.
    """
    matched = _matched(points, clean_points, workers)
    return _point_to_surface(matched, _clean_normals(matched, clean_normals, workers))


def normal_error(
    points: ArrayLike,
    normals: ArrayLike,
    clean_points: ArrayLike,
    clean_normals: ArrayLike | None = None,
    *,
    workers: int = -1,
) -> tuple[float, float]:
    """Angle between each normal and that of the nearest clean point, up to sign.

    Parameters
    ----------
    points, normals : (N, 3) array_like
    clean_points : (M, 3) array_like
    clean_normals : (M, 3) array_like, optional
        By default PCA normals of the clean cloud, k = 12.
    workers : int
        Threads of the neighbour search; -1 takes all.

    Returns
    -------
    mean, rms : float
        Degrees.
    """
    matched = _matched(points, clean_points, workers)
    return _normal_error(matched, _rows(normals), _clean_normals(matched, clean_normals, workers))


def score(
    points: ArrayLike,
    normals: ArrayLike | None,
    clean_points: ArrayLike,
    clean_normals: ArrayLike | None = None,
    *,
    workers: int = -1,
) -> Scores:
    """All measures at once.

    Parameters
    ----------
    points : (N, 3) array_like
        The denoised cloud.
    normals : (N, 3) array_like or None
        Its normals, of any length but zero.
    clean_points : (M, 3) array_like
    clean_normals : (M, 3) array_like, optional
        By default PCA normals of the clean cloud, k = 12.
    workers : int
        Threads of the neighbour search; -1 takes all.

    Raises
    ------
    PcdnfError
        ``bad_shape`` for anything but (N, 3); ``zero_extent`` for a clean cloud without one.
    """
    matched = _matched(points, clean_points, workers)
    reference = _clean_normals(matched, clean_normals, workers)
    mean, rms = (None, None) if normals is None else _normal_error(matched, _rows(normals), reference)
    return Scores(
        chamfer_distance=_chamfer_distance(matched, workers),
        point_to_surface=_point_to_surface(matched, reference),
        normal_mean=mean,
        normal_rms=rms,
        points=len(matched.points),
    )


def point_errors(
    points: ArrayLike,
    normals: ArrayLike | None,
    clean_points: ArrayLike,
    clean_normals: ArrayLike | None = None,
    *,
    workers: int = -1,
) -> PointErrors:
    """Compute the errors point by point; parameters and exceptions are those of :func:`score`."""
    matched = _matched(points, clean_points, workers)
    reference = _clean_normals(matched, clean_normals, workers)
    angle = None if normals is None else _angles(matched, _rows(normals), reference)
    return PointErrors(surface=_heights(matched, reference) / SURFACE_UNIT, angle=angle)


def _rows(array: ArrayLike) -> Floats:
    rows = np.asarray(array, np.float64)
    if rows.ndim != 2 or rows.shape[1] != 3 or not len(rows):
        raise PcdnfError(
            f"The array must have the shape (N, 3), not {rows.shape}.",
            code="bad_shape",
            hint="Pass one row of three numbers per point.",
        )
    return rows


def _matched(points: ArrayLike, clean_points: ArrayLike, workers: int) -> _Matched:
    clean = _rows(clean_points)
    low, high = clean.min(axis=0), clean.max(axis=0)
    diagonal = float(np.linalg.norm(high - low))
    if not diagonal > 0:
        raise PcdnfError(
            "All points of the clean cloud are identical.", code="zero_extent", hint="Pass another clean cloud."
        )
    located, clean = (_rows(points) - low) / diagonal, (clean - low) / diagonal
    distance, nearest = cKDTree(clean).query(located, workers=workers)
    return _Matched(located, clean, distance, nearest)


def _clean_normals(matched: _Matched, clean_normals: ArrayLike | None, workers: int) -> Floats:
    if clean_normals is None:
        return pca_normals(matched.clean, CLEAN_NORMAL_NEIGHBOURS, workers=workers).astype(np.float64)
    return _unit(_rows(clean_normals), len(matched.clean))


def _unit(normals: Floats, count: int) -> Floats:
    if len(normals) != count:
        raise PcdnfError(
            f"There are {len(normals)} normals for {count} points.",
            code="bad_shape",
            hint="Pass one normal per point.",
        )
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    unit: Floats = normals / np.maximum(length, np.finfo(np.float64).tiny)
    return unit


def _chamfer_distance(matched: _Matched, workers: int) -> float:
    back, _ = cKDTree(matched.points).query(matched.clean, workers=workers)
    return float(np.square(matched.distance).mean() + np.square(back).mean()) / CHAMFER_UNIT


def _heights(matched: _Matched, clean_normals: Floats) -> Floats:
    offset = matched.points - matched.clean[matched.nearest]
    height = np.abs(np.einsum("nd,nd->n", offset, clean_normals[matched.nearest]))
    smaller: Floats = np.minimum(height, matched.distance)
    return smaller


def _point_to_surface(matched: _Matched, clean_normals: Floats) -> float:
    return float(_heights(matched, clean_normals).mean()) / SURFACE_UNIT


def _angles(matched: _Matched, normals: Floats, clean_normals: Floats) -> Floats:
    unit = _unit(normals, len(matched.points))
    cosine = np.abs(np.einsum("nd,nd->n", unit, clean_normals[matched.nearest]))
    degrees: Floats = np.degrees(np.arccos(np.minimum(cosine, 1.0)))
    return degrees


def _normal_error(matched: _Matched, normals: Floats, clean_normals: Floats) -> tuple[float, float]:
    degrees = _angles(matched, normals, clean_normals)
    return float(degrees.mean()), float(np.sqrt(np.square(degrees).mean()))
