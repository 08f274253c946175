"""Programs and libraries that people go on with: each reads a file and says what it found there, by itself."""

from __future__ import annotations

import json
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]
NODE_MODULES = Path(__file__).parents[2] / "node_modules"
WEB = Path(__file__).with_name("web.mjs")


@dataclass
class Found:
    """What a reader found: arrays, or None for what it has no place for or did not find."""

    points: Array
    normals: Array | None = None
    colours: Array | None = None
    intensity: Array | None = None
    time: Array | None = None
    classes: Array | None = None


@dataclass(frozen=True)
class Peer:
    """A reader: its name, the formats it is asked for, how it is found, and what it does.

    It is found as a Python module, as a program of a Debian package, or as a package of npm (after `npm install`).
    """

    name: str
    endings: tuple[str, ...]
    module: str
    read: Callable[[Path], Found]
    program: str = ""
    package: str = ""
    npm: str = ""

    @property
    def is_here(self) -> bool:
        """Whether it is installed."""
        if self.npm:
            return shutil.which("node") is not None and (NODE_MODULES / self.npm).is_dir()
        return shutil.which(self.program) is not None if self.program else find_spec(self.module) is not None

    @property
    def version(self) -> str:
        """Its version, by its package."""
        if self.npm:
            return str(json.loads((NODE_MODULES / self.npm / "package.json").read_text())["version"])
        if self.package:
            listed = subprocess.run(
                ["dpkg-query", "-W", "-f", "${Version}", self.package], capture_output=True, text=True
            )
            return listed.stdout.split("+")[0].split("-")[0]
        try:
            return version(self.module)
        except PackageNotFoundError:
            return "?"


def _columns(get: Callable[[str], Any], *names: str) -> Array | None:
    try:
        return np.stack([np.asarray(get(name), np.float64) for name in names], axis=1)
    except (KeyError, ValueError, AttributeError):
        return None


def _column(get: Callable[[str], Any], name: str) -> Array | None:
    try:
        return np.asarray(get(name), np.float64).reshape(-1)
    except (KeyError, ValueError, AttributeError):
        return None


def _plyfile(path: Path) -> Found:
    from plyfile import PlyData

    rows = PlyData.read(str(path))["vertex"].data
    return _by_names(lambda name: rows[name])


def _by_names(get: Callable[[str], Any]) -> Found:
    points = _columns(get, "x", "y", "z")
    assert points is not None
    normals = _columns(get, "nx", "ny", "nz")
    return Found(
        points,
        normals if normals is not None else _columns(get, "normal_x", "normal_y", "normal_z"),
        _columns(get, "red", "green", "blue"),
        _column(get, "intensity"),
        _column(get, "gps_time"),
        _column(get, "classification"),
    )


def _open3d(path: Path) -> Found:
    import open3d

    cloud = open3d.io.read_point_cloud(str(path))
    colours = np.asarray(cloud.colors) * 255 if cloud.has_colors() else None
    return Found(np.asarray(cloud.points), np.asarray(cloud.normals) if cloud.has_normals() else None, colours)


def _open3d_tensor(path: Path) -> Found:
    import open3d

    parts = open3d.t.io.read_point_cloud(str(path)).point
    names = {"x": "positions", "nx": "normals", "red": "colors"}

    def get(name: str) -> Any:
        return parts[name].numpy()[:, 0]

    def table(name: str) -> Any:
        return np.asarray(parts[names[name]].numpy(), np.float64) if names[name] in parts else None

    colours = table("red")
    return Found(table("x"), table("nx"), colours, _column(get, "intensity"), _column(get, "gps_time"),
                 _column(get, "classification"))  # fmt: skip


def _pymeshlab(path: Path) -> Found:
    import pymeshlab

    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(str(path))
    mesh = meshes.current_mesh()
    colours = mesh.vertex_color_matrix()[:, :3] * 255 if mesh.has_vertex_color() else None
    return Found(mesh.vertex_matrix(), mesh.vertex_normal_matrix(), colours)


def _trimesh(path: Path) -> Found:
    import trimesh

    cloud: Any = trimesh.load(str(path))
    colours = np.asarray(cloud.colors)[:, :3] if len(np.asarray(cloud.colors)) else None
    return Found(np.asarray(cloud.vertices), None, colours)


def _pypcd4(path: Path) -> Found:
    from pypcd4 import PointCloud

    cloud = PointCloud.from_path(path)
    names = list(cloud.fields)
    found = _by_names(lambda name: cloud.numpy((name,))[:, 0] if name in names else {}[name])
    if "rgb" in names:
        found.colours = np.asarray(PointCloud.decode_rgb(cloud.numpy(("rgb",))), np.float64)
    return found


def _pcl(path: Path) -> Found:
    """What is left of a cloud after PCL read, filtered and wrote it."""
    with tempfile.TemporaryDirectory() as name:
        out = Path(name) / "out.pcd"
        command = ["pcl_passthrough_filter", str(path), str(out), "-min", "-1e9", "-max", "1e9", "-field", "z"]
        if path.suffix == ".ply":
            command = ["pcl_ply2pcd", str(path), str(out)]
        subprocess.run(command, capture_output=True, check=True)
        plain = Path(name) / "plain.pcd"
        subprocess.run(["pcl_convert_pcd_ascii_binary", str(out), str(plain), "1"], capture_output=True, check=True)
        return _binary_pcd(plain.read_bytes())


def _binary_pcd(data: bytes) -> Found:
    """The fields of a binary PCD, read by its header and nothing else."""
    head, _, body = data.partition(b"DATA binary\n")
    lines = {line.split()[0].decode(): line.decode().split()[1:] for line in head.splitlines()}
    counts = map(int, lines["COUNT"])
    kinds = [f"<{kind.lower()}{size}" for kind, size in zip(lines["TYPE"], lines["SIZE"], strict=True)]
    names = [f"{name}{number}" if name == "_" else name for number, name in enumerate(lines["FIELDS"])]
    rows = np.frombuffer(
        body, [(n, k, (c,)) for n, k, c in zip(names, kinds, counts, strict=True)], int(lines["POINTS"][0])
    )
    found = _by_names(lambda name: rows[name][:, 0])
    if "rgb" in names:
        octets = np.ascontiguousarray(rows["rgb"]).view(np.uint8).reshape(-1, 4)
        found.colours = octets[:, 2::-1].astype(np.float64)
    return found


def cloudcompare_columns(path: Path) -> tuple[list[str], Array]:
    """The columns of the text that CloudCompare writes of a cloud: names in lower case, and values."""
    with tempfile.TemporaryDirectory() as name:
        source = Path(name) / f"in{path.suffix}"
        shutil.copy(path, source)
        command = ["xvfb-run", "-a", "CloudCompare", "-SILENT", "-AUTO_SAVE", "OFF"]
        command += ["-O", "-GLOBAL_SHIFT", "AUTO", str(source)]
        command += ["-C_EXPORT_FMT", "ASC", "-ADD_HEADER", "-PREC", "9", "-SAVE_CLOUDS", "FILE", f"{name}/out.asc"]
        subprocess.run(command, capture_output=True, timeout=120, check=False)
        head, *lines = Path(name, "out.asc").read_text().splitlines()
    names = [part.lower() for part in head.lstrip("/").split()]
    return names, np.array([line.split() for line in lines if len(line.split()) == len(names)], float)


def _cloudcompare(path: Path) -> Found:
    names, table = cloudcompare_columns(path)
    renamed = {"r": "red", "g": "green", "b": "blue", "gpstime": "gps_time"}
    columns = {renamed.get(one, one): table[:, number] for number, one in enumerate(names)}
    return _by_names(lambda one: columns[one])


def _laspy(path: Path) -> Found:
    import laspy

    return _from_las(laspy.read(path))


def _from_las(las: Any) -> Found:
    names = set(las.point_format.dimension_names)

    def get(name: str) -> Any:
        return las[name] if name in names else {}[name]

    points = np.stack([np.asarray(las[axis], np.float64) for axis in "xyz"], axis=1)
    colours = _columns(get, "red", "green", "blue")
    return Found(points, _columns(get, "NormalX", "NormalY", "NormalZ"), colours, _column(get, "intensity"),
                 _column(get, "gps_time"), _column(get, "classification"))  # fmt: skip


def _laspy_copc(path: Path) -> Found:
    import laspy

    with laspy.CopcReader.open(path) as reader:
        points = reader.query()
        found = Found(np.stack([np.asarray(points[axis], np.float64) for axis in "xyz"], axis=1))
        found.intensity, found.time = np.asarray(points.intensity, float), np.asarray(points.gps_time)
        found.classes = np.asarray(points.classification, float)
        found.colours = np.stack([np.asarray(points[one], float) for one in ("red", "green", "blue")], axis=1)
        return found


def _copclib(path: Path) -> Found:
    import copclib

    points = copclib.FileReader(str(path)).GetAllPoints()

    def get(name: str) -> Any:
        return getattr(points, name)

    table = _columns(get, "x", "y", "z")
    assert table is not None
    return Found(table, None, _columns(get, "red", "green", "blue"), _column(get, "intensity"),
                 _column(get, "gps_time"), _column(get, "classification"))  # fmt: skip


def _pye57(path: Path) -> Found:
    import pye57

    with pye57.E57(str(path)) as file:
        scan = file.read_scan(0, intensity=True, colors=True, ignore_missing_fields=True)
        raw = file.read_scan_raw(0, ignore_unsupported_fields=True)
    return Found(
        np.stack([scan[f"cartesian{axis}"] for axis in "XYZ"], axis=1),
        _columns(lambda name: raw[name], "nor:normalX", "nor:normalY", "nor:normalZ"),
        _columns(lambda name: scan[name], "colorRed", "colorGreen", "colorBlue"),
        _column(lambda name: scan[name], "intensity"),
    )


def _web(library: str) -> Callable[[Path], Found]:
    """What a library of the web finds, in JavaScript."""

    def read(path: Path) -> Found:
        done = subprocess.run(["node", str(WEB), library, str(path)], capture_output=True, text=True, check=True)
        found = json.loads(done.stdout)

        def table(name: str, values: int = 3) -> Array | None:
            return None if found.get(name) is None else np.array(found[name], float).reshape(-1, values)

        colours = table("colours", found.get("colourValues", 3))
        if colours is not None and library == "three":
            colours = _as_bytes(colours)
        points, intensity = table("points"), found.get("intensity")
        assert points is not None
        return Found(
            points,
            table("normals"),
            None if colours is None else colours[:, :3],
            None if intensity is None else np.array(intensity, float),
            classes=None if found.get("classes") is None else np.array(found["classes"], float),
        )

    return read


def _as_bytes(linear: Array) -> Array:
    """Colours of three.js, which are linear, from 0 to 1 or to 255, as the 8 bits they came from (IEC 61966-2-1)."""
    linear = linear / 255 if linear.max() > 1 else linear
    return np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055) * 255


def _numpy(path: Path) -> Found:
    lines = path.read_text().splitlines()
    cells = [line.replace(",", " ").split() for line in lines if line[:1] in "-.0123456789"]
    table = np.array([row for row in cells if len(row) > 1], float)
    names = ["x", "y", "z", "intensity", "red", "green", "blue"]
    if path.suffix != ".pts":
        head = next(line for line in lines if "nx" in line and "pcdnf" not in line)
        names = head.lstrip("# ").replace(",", " ").split()
    columns = {one: table[:, number] for number, one in enumerate(names)}
    return _by_names(lambda one: columns[one])


PEERS = (
    Peer("plyfile", ("ply",), "plyfile", _plyfile),
    Peer("Open3D", ("ply", "pcd", "pts"), "open3d", _open3d),
    Peer("Open3D tensor", ("ply", "pcd", "pts"), "open3d", _open3d_tensor),
    Peer("pymeshlab", ("ply",), "pymeshlab", _pymeshlab),
    Peer("trimesh", ("ply",), "trimesh", _trimesh),
    Peer("pypcd4", ("pcd",), "pypcd4", _pypcd4),
    Peer("PCL", ("ply", "pcd"), "", _pcl, program="pcl_passthrough_filter", package="pcl-tools"),
    Peer("CloudCompare", ("ply", "xyz"), "", _cloudcompare, program="CloudCompare", package="cloudcompare"),
    Peer("laspy", ("las", "laz"), "laspy", _laspy),
    Peer("laspy, queries", ("copc.laz",), "laspy", _laspy_copc),
    Peer("copclib", ("copc.laz",), "copclib", _copclib),
    Peer("pye57", ("e57",), "pye57", _pye57),
    Peer("three.js", ("ply", "pcd"), "", _web("three"), npm="three"),
    Peer("loaders.gl", ("ply", "pcd", "las", "laz"), "", _web("loaders"), npm="@loaders.gl/core"),
    Peer("numpy", ("xyz", "csv", "pts"), "numpy", _numpy),
)
