"""Points that no fit uses: those of ignored classes, and faint Gaussian splats. They come back unchanged."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .attributes import numbers, renamed
from .errors import FormatError
from .limits import Limits
from .point_cloud import PointCloud
from .roles import SPLAT

FAINT = 0.1
"""Opacity below which a splat hardly shows: a floater or the inside of an object, not its surface."""
_LOGIT = float(np.log(FAINT / (1 - FAINT)))  # files hold the logit of the opacity
_FEWEST = 100
"""Splats that a surface needs; where fewer are clear, all of them count."""


def points_to_fit(cloud: PointCloud, classes: Sequence[int] = (), limits: Limits | None = None) -> PointCloud:
    """Return the cloud of the points that fits use; ``whole`` puts the others back unchanged.

    Parameters
    ----------
    cloud : PointCloud
    classes : sequence of int
        Values of the column ``classification`` that are left out.
    limits : Limits, optional
        Whose minimum the points that are left must reach.

    Raises
    ------
    FormatError
        See :func:`without_classes`.
    """
    return without_faint_splats(without_classes(cloud, classes, limits))


def without_faint_splats(cloud: PointCloud) -> PointCloud:
    """Return Gaussian splats without those whose opacity is below :data:`FAINT`; other clouds as they are."""
    if not cloud.attributes.keys() >= SPLAT:
        return cloud
    clear = cloud.attributes["opacity"] >= _LOGIT
    faint = np.flatnonzero(~clear)
    if not len(faint) or len(cloud) - len(faint) < _FEWEST:
        return cloud
    return cloud.aside(
        faint, f"{len(faint)} of {len(cloud)} splats have an opacity below {FAINT:.0%} and were left as they are."
    )


def without_classes(cloud: PointCloud, classes: Sequence[int], limits: Limits | None = None) -> PointCloud:
    """Return the cloud without the points of some classes, which ``whole`` puts back unchanged.

    Parameters
    ----------
    cloud : PointCloud
    classes : sequence of int
        As in the column ``classification``; none leaves the cloud as it is.
    limits : Limits, optional
        Whose minimum the points that are left must reach.

    Raises
    ------
    FormatError
        ``missing_column`` where the cloud has no classification, ``too_few_points`` where too few are left.
    """
    if not classes:
        return cloud
    found = _of_classes(cloud, classes)
    left, needed = len(cloud) - len(found), (limits or Limits()).minimum_points
    if left < needed:
        raise FormatError(
            f"Without the classes {', '.join(map(str, classes))} the cloud has {left} points; at least {needed} are "
            "needed.",
            code="too_few_points",
            hint="Ignore fewer classes.",
            limit=needed,
            actual=left,
        )
    return cloud.aside(
        found, f"{len(found)} points of the classes {', '.join(map(str, classes))} were left as they are."
    )


def _of_classes(cloud: PointCloud, classes: Sequence[int]) -> NDArray[np.int64]:
    """Rows of the points whose classification is one of ``classes``, ascending."""
    column = renamed(cloud.attributes).get("classification")
    values = None if column is None else numbers(column)
    if values is None or values.ndim != 1:
        raise FormatError(
            "The cloud has no classification, so no classes can be left out.",
            code="missing_column",
            hint="Name no classes to ignore, or send a LAS or LAZ with classes.",
        )
    return np.flatnonzero(np.isin(values, classes))
