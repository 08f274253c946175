"""Programs and libraries whose files people have: each writes the cloud of the matrix, by itself."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from pcdnf.formats import PointCloud
from tests.interop.peers import Array, Peer

Write = Callable[[Path, PointCloud], None]


def _colours(cloud: PointCloud) -> Array:
    return np.stack([cloud.attributes[name] for name in ("red", "green", "blue")], axis=1)


def _plyfile(path: Path, cloud: PointCloud) -> None:
    from plyfile import PlyData, PlyElement

    kinds = [(name, "f8") for name in "xyz"] + [(name, "f4") for name in ("nx", "ny", "nz")]
    rows = np.zeros(len(cloud), kinds + [(name, column.dtype.str) for name, column in cloud.attributes.items()])
    for axis, (point, normal) in enumerate(zip("xyz", ("nx", "ny", "nz"), strict=True)):
        rows[point], rows[normal] = cloud.points[:, axis], cloud.normals[:, axis]
    for name, column in cloud.attributes.items():
        rows[name] = column
    PlyData([PlyElement.describe(rows, "vertex")]).write(str(path))


def _open3d(path: Path, cloud: PointCloud) -> None:
    import open3d

    given = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(cloud.points))
    given.normals = open3d.utility.Vector3dVector(cloud.normals.astype(float))
    given.colors = open3d.utility.Vector3dVector(_colours(cloud) / 255)
    assert open3d.io.write_point_cloud(str(path), given)


def _open3d_tensor(path: Path, cloud: PointCloud) -> None:
    import open3d

    given = open3d.t.geometry.PointCloud(open3d.core.Tensor(cloud.points))
    given.point["normals"] = open3d.core.Tensor(np.ascontiguousarray(cloud.normals, np.float64))
    given.point["colors"] = open3d.core.Tensor(_colours(cloud))
    assert open3d.t.io.write_point_cloud(str(path), given)


def _pymeshlab(path: Path, cloud: PointCloud) -> None:
    import pymeshlab

    colours = np.c_[_colours(cloud) / 255, np.ones(len(cloud))]
    mesh = pymeshlab.Mesh(cloud.points, v_normals_matrix=cloud.normals.astype(float), v_color_matrix=colours)
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(mesh)
    meshes.save_current_mesh(str(path))


def _trimesh(path: Path, cloud: PointCloud) -> None:
    import trimesh

    hull = trimesh.PointCloud(cloud.points).convex_hull  # of a sphere: all of its points
    tree: Any = hull.kdtree
    hull.visual.vertex_colors = _colours(cloud)[np.argsort(tree.query(cloud.points)[1])]
    hull.vertices, hull.faces = _in_order(hull, cloud)
    hull.export(str(path))


def _in_order(hull: Any, cloud: PointCloud) -> tuple[Array, Array]:
    number = hull.kdtree.query(cloud.points)[1]
    place = np.argsort(number)
    return cloud.points[place][number], place[hull.faces]


def _pypcd4(path: Path, cloud: PointCloud) -> None:
    from pypcd4 import PointCloud as Cloud

    packed = Cloud.encode_rgb(_colours(cloud)).reshape(-1, 1)
    Cloud.from_xyzrgb_points(np.hstack([cloud.points.astype(np.float32), packed.view(np.float32)])).save(str(path))


def _pcl(path: Path, cloud: PointCloud) -> None:
    with tempfile.TemporaryDirectory() as name:
        _plyfile(Path(name) / "a.ply", cloud)
        subprocess.run(["pcl_ply2pcd", f"{name}/a.ply", str(path)], capture_output=True, check=True)


def _cloudcompare(path: Path, cloud: PointCloud) -> None:
    kinds = {"ply": ["PLY"], "xyz": ["ASC", "-PREC", "9", "-ADD_HEADER"]}
    with tempfile.TemporaryDirectory() as name:
        _plyfile(Path(name) / "a.ply", cloud)
        command = ["xvfb-run", "-a", "CloudCompare", "-SILENT", "-AUTO_SAVE", "OFF"]
        command += ["-O", "-GLOBAL_SHIFT", "AUTO", f"{name}/a.ply", "-C_EXPORT_FMT", *kinds[path.suffix[1:]]]
        subprocess.run([*command, "-SAVE_CLOUDS", "FILE", str(path)], capture_output=True, timeout=120, check=False)


def _laspy(path: Path, cloud: PointCloud) -> None:
    import laspy

    las = laspy.create(point_format=7, file_version="1.4")
    las.header.scales, las.header.offsets = [0.0001] * 3, np.floor(cloud.points.min(axis=0))
    las.x, las.y, las.z = cloud.points.T
    las.red, las.green, las.blue = _colours(cloud).astype(np.uint16).T * 257
    las.intensity, las.gps_time = cloud.attributes["intensity"], cloud.attributes["gps_time"]
    las.classification = cloud.attributes["classification"]
    for axis, one in enumerate("XYZ"):
        las.add_extra_dim(laspy.ExtraBytesParams(f"Normal{one}", np.float32))
        las[f"Normal{one}"] = cloud.normals[:, axis]
    las.write(str(path))


def _pye57(path: Path, cloud: PointCloud) -> None:
    import pye57

    given = {f"cartesian{axis}": np.ascontiguousarray(cloud.points[:, i]) for i, axis in enumerate("XYZ")}
    given |= {f"color{one.title()}": cloud.attributes[one].astype(np.uint8) for one in ("red", "green", "blue")}
    given["intensity"] = cloud.attributes["intensity"].astype(np.float32)
    with pye57.E57(str(path), mode="w") as file:
        file.write_scan_raw(given)


def _numpy(path: Path, cloud: PointCloud) -> None:
    colours = dict(zip(("red", "green", "blue"), _colours(cloud).T, strict=True))
    rest = {name: column for name, column in cloud.attributes.items() if name not in colours}
    np.savez(path, points=cloud.points, normals=cloud.normals, **colours, **rest)


def _by_module(name: str, endings: tuple[str, ...], module: str, write: Write) -> tuple[Peer, Write]:
    return Peer(name, endings, module, read=_unread), write


def _unread(path: Path) -> Any:
    raise NotImplementedError(f"{path}: writers are not asked to read")


WRITERS = (
    _by_module("plyfile", ("ply",), "plyfile", _plyfile),
    _by_module("Open3D", ("ply", "pcd", "xyz", "xyzn", "xyzrgb", "pts"), "open3d", _open3d),
    _by_module("Open3D tensor", ("ply", "pcd", "npz"), "open3d", _open3d_tensor),
    _by_module("pymeshlab", ("ply", "obj", "off"), "pymeshlab", _pymeshlab),
    _by_module("trimesh", ("ply", "obj", "off", "stl"), "trimesh", _trimesh),
    _by_module("pypcd4", ("pcd",), "pypcd4", _pypcd4),
    (Peer("PCL", ("pcd",), "", _unread, program="pcl_ply2pcd", package="pcl-tools"), _pcl),
    (
        Peer("CloudCompare", ("ply", "xyz"), "", _unread, program="CloudCompare", package="cloudcompare"),
        _cloudcompare,
    ),
    _by_module("laspy", ("las", "laz"), "laspy", _laspy),
    _by_module("pye57", ("e57",), "pye57", _pye57),
    _by_module("numpy", ("npz",), "numpy", _numpy),
)
"""Writers, the formats that each is asked for, and what it does."""
