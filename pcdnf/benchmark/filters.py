"""Classical filters of libraries, with a number of neighbours that the truth chooses: jet, plane, bilateral."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import version
from typing import ClassVar

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
class NeighbourFilter:
    """A filter whose one parameter is a number of neighbours."""

    neighbours: int
    group: Group = "peer"
    method: ClassVar[str]

    @property
    def name(self) -> str:
        """Return the parameter in words."""
        return f"k = {self.neighbours}"

    @property
    def identity(self) -> dict[str, str]:
        """Return all that the output depends on besides the input."""
        return {"method": self.method, "neighbours": str(self.neighbours)}


class Jet(NeighbourFilter):
    """``CGAL::jet_smooth_point_set`` with k neighbours."""

    method = "jet"

    @property
    def identity(self) -> dict[str, str]:
        """Return all that the output depends on besides the input."""
        return super().identity | {"cgal": version("cgal")}

    def run(self, points: Points, level: float) -> Output:  # noqa: ARG002
        """Project every point onto the jet fitted to its neighbours."""
        cloud = cgal_cloud(points)
        cgal_processing().jet_smooth_point_set(cloud, self.neighbours)
        return cgal_output(cloud)


class Bilateral(NeighbourFilter):
    """``CGAL::bilateral_smooth_point_set`` with k neighbours, three times."""

    method = "bilateral"

    @property
    def identity(self) -> dict[str, str]:
        """Return all that the output depends on besides the input."""
        return super().identity | {"passes": "3", "cgal": version("cgal")}

    def run(self, points: Points, level: float) -> Output:  # noqa: ARG002
        """Smooth points and normals together, from PCA normals."""
        cloud = cgal_cloud(points)
        cgal_processing().pca_estimate_normals(cloud, self.neighbours)
        for _ in range(3):
            cgal_processing().bilateral_smooth_point_set(cloud, self.neighbours)
        return cgal_output(cloud)


class Plane(NeighbourFilter):
    """Projection onto the PCA plane of k neighbours."""

    method = "plane"

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
