"""Methods of others that install from PyPI: CGAL (GPL) and Open3D, the extra ``peers``.

CGAL's bindings keep the points in order; WLOP alone draws new ones.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import PcdnfError
from ..geometry.normals import pca_normals
from .methods import Group, Method, Output

Points = NDArray[np.float64]

NEIGHBOURS = {0.0: 24, 0.25: 60, 0.5: 60, 1.0: 120, 1.5: 240, 2.5: 480}
"""Of jet and bilateral by noise level, for clouds of 100 000 points; chosen with the clean clouds, in their favour."""
BILATERAL_PASSES = 3
WLOP_KEPT = 50.0
"""Per cent of the points: WLOP is a resampling, and at 100 % it clusters."""
PCA_NEIGHBOURS = (24, 60, 100, 240, 480)
PEERS = ("jet", "bilateral", "wlop", "pca", "pcl-mls", "rimls", "apss", "cloudcompare")
"""On clean clouds; the last four are programs, see :mod:`.filters`."""


@dataclass(frozen=True)
class Jet:
    """Osculating jets (Cazals and Pouget 2003): ``CGAL::jet_smooth_point_set``."""

    name: str = "CGAL jet"
    group: Group = "peer"

    @property
    def identity(self) -> dict[str, str]:
        """All that the output depends on besides the input."""
        return {"method": "jet", "neighbours": str(NEIGHBOURS), "cgal": version("cgal")}

    def run(self, points: Points, level: float) -> Output:
        """Project every point onto the jet fitted to its neighbours."""
        cloud = cgal_cloud(points)
        neighbours = _neighbours(level, len(points))
        cgal_processing().jet_smooth_point_set(cloud, neighbours)
        return cgal_output(cloud, neighbours=neighbours)


@dataclass(frozen=True)
class Bilateral:
    """Edge-aware resampling's smoothing (Huang et al. 2013): ``CGAL::bilateral_smooth_point_set``, three times."""

    name: str = f"CGAL bilateral x {BILATERAL_PASSES}"
    group: Group = "peer"

    @property
    def identity(self) -> dict[str, str]:
        """All that the output depends on besides the input."""
        return {"method": "bilateral", "neighbours": str(NEIGHBOURS), "cgal": version("cgal")}

    def run(self, points: Points, level: float) -> Output:
        """Smooth points and normals together, from PCA normals."""
        cloud = cgal_cloud(points)
        neighbours = _neighbours(level, len(points))
        cgal_processing().pca_estimate_normals(cloud, neighbours)
        for _ in range(BILATERAL_PASSES):
            cgal_processing().bilateral_smooth_point_set(cloud, neighbours)  # a third argument makes it return NaN
        return cgal_output(cloud, neighbours=neighbours)


@dataclass(frozen=True)
class Wlop:
    """Weighted locally optimal projection (Huang et al. 2009): half of the points, so no fair chamfer distance."""

    name: str = "CGAL WLOP (50 %)"
    group: Group = "peer"

    @property
    def identity(self) -> dict[str, str]:
        """All that the output depends on besides the input."""
        return {"method": "wlop", "kept": str(WLOP_KEPT), "cgal": version("cgal")}

    def run(self, points: Points, level: float) -> Output:  # noqa: ARG002
        """Resample with CGAL's default radius, eight times the average spacing."""
        resampled = importlib.import_module("CGAL.CGAL_Point_set_3").Point_set_3()
        cgal_processing().wlop_simplify_and_regularize_point_set(cgal_cloud(points), resampled, WLOP_KEPT)
        return cgal_output(resampled)


@dataclass(frozen=True)
class Pca:
    """Open3D's PCA normals of the noisy points, from k neighbours."""

    neighbours: int
    group: Group = "normals"

    @property
    def name(self) -> str:
        """Name in the tables."""
        return f"PCA, k = {self.neighbours}"

    @property
    def identity(self) -> dict[str, str]:
        """All that the output depends on besides the input."""
        return {"method": "pca", "neighbours": str(self.neighbours), "open3d": version("open3d")}

    def run(self, points: Points, level: float) -> Output:  # noqa: ARG002
        """Estimate normals, leave the points."""
        open3d = importlib.import_module("open3d")
        cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
        search = open3d.geometry.KDTreeSearchParamKNN(self.neighbours)
        cloud.estimate_normals(search, fast_normal_computation=False)
        return Output(points, np.asarray(cloud.normals))


def peer_methods(names: Sequence[str]) -> list[Method]:
    """Return the methods of the named peers.

    Raises
    ------
    PcdnfError
        ``unknown_peer``; ``missing_extra`` where its library is not installed.
    """
    rows: dict[str, list[Method]] = {
        "jet": [Jet()],
        "bilateral": [Bilateral()],
        "wlop": [Wlop()],
        "pca": [Pca(neighbours) for neighbours in PCA_NEIGHBOURS],
    }
    for name in names:
        if name not in rows:
            raise PcdnfError(
                f"There is no peer named {name!r}.", code="unknown_peer", hint=f"Use some of {', '.join(PEERS)}."
            )
        library = "open3d" if name == "pca" else "CGAL"
        try:
            importlib.import_module(library)
        except ImportError as error:
            raise PcdnfError(
                f"{name} needs {library}, which cannot be imported.",
                code="missing_extra",
                hint="Run pip install 'pcdnf[peers]', or leave it out of --peers.",
            ) from error
    return [row for name in names for row in rows[name]]


def _neighbours(level: float, points: int) -> int:
    """Of the first level in the table that is not below this one; fewer than there are points."""
    count = next((count for at, count in NEIGHBOURS.items() if at >= level), max(NEIGHBOURS.values()))
    return min(count, points - 1)


def cgal_processing() -> Any:
    """CGAL's module of point-set processing."""
    return importlib.import_module("CGAL.CGAL_Point_set_processing_3")


def cgal_cloud(points: Points) -> Any:
    """Points (N, 3) as a point set of CGAL's."""
    point = importlib.import_module("CGAL.CGAL_Kernel").Point_3
    cloud = importlib.import_module("CGAL.CGAL_Point_set_3").Point_set_3()
    cloud.reserve(len(points))
    for x, y, z in points.tolist():
        cloud.insert(point(x, y, z))
    return cloud


def cgal_output(cloud: Any, **facts: Any) -> Output:
    """Return a point set of CGAL's as an output; raises ``peer_failed`` where it holds nothing of use."""
    points = np.array([(point.x(), point.y(), point.z()) for point in cloud.points()])
    if not len(points) or not np.isfinite(points).all():
        raise PcdnfError(
            "CGAL returned no points, or some that are not finite.",
            code="peer_failed",
            hint="Leave this peer out of --peers.",
        )
    return Output(points, pca_normals(points), facts)
