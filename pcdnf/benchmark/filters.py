"""Classical filters of libraries, with a number of neighbours that the truth chooses: jet, plane, bilateral."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import version

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..geometry.frames import principal_axes
from .methods import Group, Output
from .peers import cgal_cloud, cgal_output, cgal_processing

Points = NDArray[np.float64]

NEIGHBOURS = (16, 32, 64, 128, 256)
"""Of jets, planes and bilateral filters."""
_AT_ONCE = 4096


@dataclass(frozen=True)
class Jet:
    """``CGAL::jet_smooth_point_set`` with k neighbours."""

    neighbours: int
    group: Group = "peer"

    @property
    def name(self) -> str:
        """Return the parameter in words."""
        return f"k = {self.neighbours}"

    @property
    def identity(self) -> dict[str, str]:
        """Return all that the output depends on besides the input."""
        return {"method": "jet", "neighbours": str(self.neighbours), "cgal": version("cgal")}

    def run(self, points: Points, level: float) -> Output:  # noqa: ARG002
        """Project every point onto the jet fitted to its neighbours."""
        cloud = cgal_cloud(points)
        cgal_processing().jet_smooth_point_set(cloud, self.neighbours)
        return cgal_output(cloud)


@dataclass(frozen=True)
class Bilateral:
    """``CGAL::bilateral_smooth_point_set`` with k neighbours, three times."""

    neighbours: int
    group: Group = "peer"

    @property
    def name(self) -> str:
        """Return the parameter in words."""
        return f"k = {self.neighbours}"

    @property
    def identity(self) -> dict[str, str]:
        """Return all that the output depends on besides the input."""
        return {"method": "bilateral", "neighbours": str(self.neighbours), "passes": "3", "cgal": version("cgal")}

    def run(self, points: Points, level: float) -> Output:  # noqa: ARG002
        """Smooth points and normals together, from PCA normals."""
        cloud = cgal_cloud(points)
        cgal_processing().pca_estimate_normals(cloud, self.neighbours)
        for _ in range(3):
            cgal_processing().bilateral_smooth_point_set(cloud, self.neighbours)
        return cgal_output(cloud)


@dataclass(frozen=True)
class Plane:
    """Projection onto the PCA plane of k neighbours."""

    neighbours: int
    group: Group = "peer"

    @property
    def name(self) -> str:
        """Return the parameter in words."""
        return f"k = {self.neighbours}"

    @property
    def identity(self) -> dict[str, str]:
        """Return all that the output depends on besides the input."""
        return {"method": "plane", "neighbours": str(self.neighbours)}

    def run(self, points: Points, level: float) -> Output:  # noqa: ARG002
        """Move every point along the plane's normal onto it."""
        moved, normals = np.empty_like(points), np.empty(points.shape, np.float32)
        tree = cKDTree(points)
        for start in range(0, len(points), _AT_ONCE):
            part = slice(start, start + _AT_ONCE)
            _, index = tree.query(points[part], min(self.neighbours, len(points)), workers=-1)
            normal = principal_axes(points, np.asarray(index, np.int64))[:, 2]
            height = ((points[part] - points[index].mean(1)) * normal).sum(1)
            moved[part], normals[part] = points[part] - height[:, None] * normal, normal
        return Output(moved, normals)
