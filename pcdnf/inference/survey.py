"""What a run knows of its cloud from the start: which points are distinct, and noise and spacing around each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..geometry.distinct import Distinct, distinct_points
from ..geometry.local_scale import LocalScale, estimate_local_scale
from ..geometry.morton import spatial_order
from .unit_frame import UnitFrame


@dataclass(frozen=True)
class Survey:
    """Of a cloud as it came; M of its N rows are distinct points.

    Attributes
    ----------
    points : ndarray, (M, 3) float64
        The distinct points, in the cloud's unit.
    distinct : Distinct
    scale : LocalScale
        Of the distinct points, in the unit of the frame.
    """

    points: NDArray[np.float64]
    distinct: Distinct
    scale: LocalScale

    def noise(self, frame: UnitFrame) -> NDArray[np.float64]:
        """Estimated noise (N,) of each row, in the cloud's unit; 0 for a row without a measurement."""
        noise = np.append(self.scale.noise, 0.0) * frame.diagonal
        return np.asarray(noise[self.distinct.of])


def survey_cloud(points: NDArray[np.float64], frame: UnitFrame) -> Survey:
    """Survey a cloud.

    Parameters
    ----------
    points : ndarray, (N, 3) float64
        As they came, in the cloud's unit.
    frame : UnitFrame
        Of the points.
    """
    distinct = distinct_points(points)
    own = points[distinct.rows]
    local = frame.to_local(own)
    return Survey(own, distinct, estimate_local_scale(local, cKDTree(local), spatial_order(local)))
