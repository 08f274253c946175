"""Classical filters that are programs, with a parameter that the truth chooses: PCL, MeshLab, CloudCompare.

They are looked for on the path: ``pcl_mls_smoothing`` (Debian's pcl-tools), ``meshlabserver`` (meshlab) and
``CloudCompare`` (cloudcompare). The last two need a display and run under ``xvfb-run``.
"""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..errors import PcdnfError
from ..formats.files import read
from ..geometry.normals import pca_normals
from ..geometry.orientation import orient_normals
from .choice import Choice
from .methods import Group, Output

Points = NDArray[np.float64]

RADII = (3.0, 5.0, 8.0, 12.0, 18.0)
"""Of PCL's filter, in spacings."""
SCALES = (2.0, 4.0, 6.0, 10.0)
"""Of MeshLab's filters, in its own local radii."""
SIGMAS = (1.0, 2.0, 3.0)
"""Of CloudCompare's filter, in standard deviations."""
SECONDS = 900
"""A program that takes longer is given up."""

PROGRAMS = {
    "pcl-mls": ("pcl_mls_smoothing",),
    "rimls": ("meshlabserver", "xvfb-run"),
    "apss": ("meshlabserver", "xvfb-run"),
    "cloudcompare": ("CloudCompare", "xvfb-run"),
}
"""Programs that a peer needs."""
_PACKAGES = {
    "pcl_mls_smoothing": "pcl-tools",
    "meshlabserver": "meshlab",
    "CloudCompare": "cloudcompare",
    "xvfb-run": "xvfb",
}


@dataclass(frozen=True)
class PclMls:
    """PCL's moving least squares of order 2: ``pcl_mls_smoothing`` with a radius in spacings."""

    spacings: float
    group: Group = "peer"

    @property
    def name(self) -> str:
        """Return the parameter in words."""
        return f"radius = {self.spacings:g} spacings"

    @property
    def identity(self) -> dict[str, str]:
        """Return all that the output depends on besides the input."""
        return {"method": "pcl_mls_smoothing", "spacings": str(self.spacings)}

    def run(self, points: Points, level: float) -> Output:  # noqa: ARG002
        """Smooth through files; points with too few neighbours are missing in the result."""
        local, back = _unit(points)
        spacing = float(np.median(cKDTree(local).query(local[:: max(1, len(local) // 2000)], [17])[0]))
        radius = self.spacings * spacing * np.sqrt(np.pi / 16)
        with TemporaryDirectory() as folder:
            given, made = Path(folder, "in.pcd"), Path(folder, "out.pcd")
            _write_pcd(given, local)
            _call(["pcl_mls_smoothing", str(given), str(made), "-radius", f"{radius:.6g}", "-polynomial_order", "2"])
            cloud = read(_there(made))
        smooth = cloud.points.astype(np.float64)
        normals = pca_normals(smooth) if cloud.normals is None else cloud.normals
        return Output(back(smooth), normals)


@dataclass(frozen=True)
class MeshLab:
    """MeshLab's projection onto a point-set surface, ``RIMLS`` or ``APSS``, from PCA normals with consistent sides."""

    surface: str
    scale: float
    group: Group = "peer"

    @property
    def name(self) -> str:
        """Return the parameter in words."""
        return f"scale = {self.scale:g}"

    @property
    def identity(self) -> dict[str, str]:
        """Return all that the output depends on besides the input."""
        return {"method": f"meshlab {self.surface}", "scale": str(self.scale)}

    def run(self, points: Points, level: float) -> Output:  # noqa: ARG002
        """Project through files."""
        local, back = _unit(points)
        normals = orient_normals(local, pca_normals(local))
        with TemporaryDirectory() as folder:
            given, made, script = (Path(folder, name) for name in ("in.ply", "out.ply", "filter.mlx"))
            _write_ply(given, local, normals)
            script.write_text(_script(self.surface, self.scale))
            _call(["xvfb-run", "-a", "meshlabserver", "-i", str(given), "-o", str(made), "-m", "vn", "-s", str(script)])
            cloud = read(_there(made))
        smooth = cloud.points.astype(np.float64)
        return Output(back(smooth), pca_normals(smooth) if cloud.normals is None else cloud.normals)


@dataclass(frozen=True)
class CloudCompare:
    """CloudCompare's statistical outlier removal: it drops points and moves none."""

    sigmas: float
    neighbours: int = 16
    group: Group = "peer"

    @property
    def name(self) -> str:
        """Return the parameter in words."""
        return f"{self.sigmas:g} sigma of {self.neighbours} neighbours"

    @property
    def identity(self) -> dict[str, str]:
        """Return all that the output depends on besides the input."""
        return {"method": "cloudcompare sor", "sigmas": str(self.sigmas), "neighbours": str(self.neighbours)}

    def run(self, points: Points, level: float) -> Output:  # noqa: ARG002
        """Drop points through files."""
        local, _ = _unit(points)
        with TemporaryDirectory() as folder:
            given, made = Path(folder, "in.xyz"), Path(folder, "out.xyz")
            # a fourth column tells which points are left
            np.savetxt(given, np.c_[local, np.arange(len(local))], "%.9g %.9g %.9g %d")
            arguments = ["-AUTO_SAVE", "OFF", "-O", str(given), "-SOR", str(self.neighbours), f"{self.sigmas:g}"]
            saving = ["-C_EXPORT_FMT", "ASC", "-PREC", "9", "-SAVE_CLOUDS", "FILE", str(made)]
            _call(["xvfb-run", "-a", "CloudCompare", "-SILENT", *arguments, *saving])
            kept = np.sort(np.loadtxt(_there(made), usecols=-1).astype(np.int64))
        return Output(points[kept], pca_normals(points[kept]), {"dropped": len(points) - len(kept)})


def program_choices() -> dict[str, Choice]:
    """Return the peers that are programs, each to be chosen by the truth."""
    return {
        "pcl-mls": Choice("PCL MLS, best radius", tuple(PclMls(radius) for radius in RADII)),
        "rimls": Choice("MeshLab RIMLS, best scale", tuple(MeshLab("RIMLS", scale) for scale in SCALES)),
        "apss": Choice("MeshLab APSS, best scale", tuple(MeshLab("APSS", scale) for scale in SCALES)),
        "cloudcompare": Choice("CloudCompare SOR, best sigma", tuple(CloudCompare(sigma) for sigma in SIGMAS)),
    }


def missing_programs(names: Sequence[str]) -> dict[str, str]:
    """Return the peers whose program is not on the path, each with a sentence that says so."""
    said = {}
    for name in names:
        lacking = [program for program in PROGRAMS.get(name, ()) if shutil.which(program) is None]
        if lacking:
            packages = " ".join(_PACKAGES[program] for program in lacking)
            said[name] = f"{name} is left out: {lacking[0]} is not on the path (apt-get install {packages})."
    return said


@dataclass(frozen=True)
class _Back:
    """From the unit box, where float32 is fine enough, to the cloud's own frame."""

    middle: Points
    size: float

    def __call__(self, local: Points) -> Points:
        return np.asarray(local * self.size + self.middle)


def _unit(points: Points) -> tuple[Points, _Back]:
    middle = (points.min(0) + points.max(0)) / 2
    size = float(np.linalg.norm(np.ptp(points, axis=0))) or 1.0
    return (points - middle) / size, _Back(middle, size)


def _write_pcd(path: Path, points: Points) -> None:
    head = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
        f"WIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(points)}\nDATA binary\n"
    )
    path.write_bytes(head.encode() + points.astype("<f4").tobytes())


def _write_ply(path: Path, points: Points, normals: NDArray[np.floating]) -> None:
    names = "".join(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz"))
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n{names}end_header\n"
    path.write_bytes(head.encode() + np.c_[points, normals].astype("<f4").tobytes())


def _script(surface: str, scale: float) -> str:
    """MeshLab's filter script, which has to hold every parameter of the filter."""
    own = (
        [("RichFloat", "SigmaN", "0.75"), ("RichInt", "MaxRefittingIters", "3")]
        if surface == "RIMLS"
        else [("RichFloat", "SphericalParameter", "1"), ("RichBool", "AccurateNormal", "true")]
    )
    values = [
        ("RichMesh", "ControlMesh", "0"),
        ("RichMesh", "ProxyMesh", "0"),
        ("RichBool", "SelectionOnly", "false"),
        ("RichFloat", "FilterScale", f"{scale:g}"),
        ("RichFloat", "ProjectionAccuracy", "0.0001"),
        ("RichInt", "MaxProjectionIters", "15"),
        *own,
        ("RichInt", "MaxSubdivisions", "0"),
        ("RichFloat", "ThAngleInDegree", "2"),
    ]
    lines = "".join(f'  <Param type="{kind}" value="{value}" name="{name}"/>\n' for kind, name, value in values)
    return (
        f'<!DOCTYPE FilterScript>\n<FilterScript>\n <filter name="MLS projection ({surface})">\n{lines}'
        " </filter>\n</FilterScript>\n"
    )


def _call(command: Sequence[str]) -> None:
    """Run a program; raise ``peer_failed`` where it fails or takes too long."""
    program = next(word for word in command if word not in ("xvfb-run", "-a"))
    try:
        done = subprocess.run(command, capture_output=True, timeout=SECONDS, check=False)
    except subprocess.TimeoutExpired as error:
        raise _failed(program, f"took more than {SECONDS} s") from error
    if done.returncode != 0:
        raise _failed(program, f"ended with status {done.returncode}")


def _there(path: Path) -> Path:
    if not path.exists():
        raise _failed(path.name, "was not written")
    return path


def _failed(program: str, what: str) -> PcdnfError:
    return PcdnfError(f"{program} {what}.", code="peer_failed", hint="Leave this peer out of --peers.")
