"""What denoising is good for: surface reconstruction, registration and plane fitting, before and after.

    python examples/applications.py [--points 30000] [--noise 1] [--model M] [--iterations auto] [--output FOLDER]

The three applications of the paper's last section, with Open3D, on scans of a made bracket whose surface is known:
screened Poisson reconstruction (mean distance between mesh and surface, both ways, x 1e3 of the diagonal, and angle of
the mesh's normals), registration of two scans that overlap in part, each with noise of its own, by ICP (rotation and
translation error), and RANSAC planes (angle to the true plane, share of its points found, share of finds that belong).
Writes ``applications.md`` and ``applications.png``. Needs the extras ``train``, ``benchmark`` and ``peers``.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import open3d
import trimesh
from make_sample import bracket
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pcdnf import Denoiser
from pcdnf.benchmark.pictures import DPI, PANEL, error_colours, save, shaded, view_of
from pcdnf.geometry.normals import pca_normals
from pcdnf.models.catalog import DEFAULT_MODEL

Floats = NDArray[np.float64]
Denoise = Callable[[Floats], tuple[Floats, Floats]]

OCTREE_DEPTH = 7
"""Of the Poisson reconstruction: cells of 1/128 of the box."""
SAMPLES = 60_000
"""Of a mesh, to measure it."""
SCANS = 3
"""Scans whose figures are averaged, and pairs of scans that are registered, each with noise of its own."""
OVERLAP = 0.7
"""Share of the surface that both scans of a pair see."""
TURN, SHIFT = 8.0, 0.04
"""Pose of the second scan: degrees, diagonals."""
REACH = 0.05
"""Farthest correspondence of ICP, in diagonals."""
PLANES = 5
THRESHOLD = 0.004
"""Farthest inlier of a plane, in diagonals."""
LARGE = 0.03
"""A facet with this share of the area counts as a plane."""


@dataclass(frozen=True)
class Scan:
    """A noisy sample of the surface.

    Attributes
    ----------
    points, normals : (N, 3) arrays
        Normals point outwards: a scanner knows the side it stands on.
    clean : (N, 3) array
    facet : (N,) int array
        Planes of the surface, -1 for what is curved or small.
    """

    points: Floats
    normals: Floats
    clean: Floats
    facet: NDArray[np.int64]


def tensor(rows: Any, kind: Any = np.float32) -> Any:
    """Open3D's array."""
    return open3d.core.Tensor(np.array(rows, kind))


def scene_of(mesh: trimesh.Trimesh) -> Any:
    """What distances to a mesh are asked of."""
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(tensor(mesh.vertices), tensor(mesh.faces, np.uint32))
    return scene


class Part:
    """The bracket: its mesh in diagonals, distances to it, its planes."""

    def __init__(self) -> None:
        mesh = bracket()
        mesh.apply_translation(-mesh.bounds.mean(axis=0))
        mesh.apply_scale(1 / np.linalg.norm(mesh.extents))
        self.mesh = mesh
        self.scene = scene_of(mesh)
        planes = np.round(np.c_[mesh.face_normals, (mesh.triangles_center * mesh.face_normals).sum(1)], 4) + 0.0
        self.planes, self.plane_of_face = np.unique(planes, axis=0, return_inverse=True)
        area = np.bincount(self.plane_of_face.ravel(), mesh.area_faces)
        self.large = np.where(area > LARGE * area.sum(), np.arange(len(area)), -1)

    def sample(self, points: int, noise: float, seed: int, cut: tuple[float, float] = (0.0, 1.0)) -> Scan:
        """Points of the surface with Gaussian noise; ``cut`` keeps a range of them along a random direction."""
        clean, faces = trimesh.sample.sample_surface(self.mesh, points, seed=seed)
        rng = np.random.default_rng(seed)
        place = np.asarray(clean) @ np.random.default_rng(seed // 2).normal(size=3)  # the same for a pair
        low, high = np.quantile(place, cut)
        kept = (place >= low) & (place <= high)
        clean, faces = np.asarray(clean)[kept], faces[kept]
        noisy = clean + rng.normal(size=clean.shape) * noise / 100
        facet = self.large[self.plane_of_face.ravel()[faces]]
        return Scan(noisy, outward(pca_normals(noisy), self.mesh.face_normals[faces]), clean, facet)

    def distance(self, points: Floats) -> Floats:
        """To the surface, in diagonals."""
        return np.float64(self.scene.compute_distance(tensor(points)).numpy())

    def normals_near(self, points: Floats) -> Floats:
        """The surface's normals at the points nearest to these."""
        return np.float64(self.scene.compute_closest_points(tensor(points))["primitive_normals"].numpy())


def outward(normals: NDArray[np.floating], like: Floats) -> Floats:
    """Normals turned to the side of others."""
    return np.where((normals * like).sum(1, keepdims=True) < 0, -1.0, 1.0) * normals


def cloud_of(points: Floats, normals: Floats | None = None) -> Any:
    """Open3D's cloud."""
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    if normals is not None:
        cloud.normals = open3d.utility.Vector3dVector(normals)
    return cloud


@dataclass(frozen=True)
class Outcome:
    """Figures of an application on one input, and what a picture shows: points, normals, colours."""

    figures: dict[str, float]
    shown: tuple[Floats, Floats, Floats]


def reconstruction(part: Part, points: Floats, normals: Floats) -> Outcome:
    """Screened Poisson (Kazhdan and Hoppe 2013)."""
    mesh, _ = open3d.geometry.TriangleMesh.create_from_point_cloud_poisson(
        cloud_of(points, normals), depth=OCTREE_DEPTH, n_threads=1
    )
    made = trimesh.Trimesh(np.asarray(mesh.vertices), np.asarray(mesh.triangles), process=False)
    samples, faces = trimesh.sample.sample_surface(made, SAMPLES, seed=0)
    samples, turned = np.asarray(samples), np.asarray(made.face_normals[faces])
    away = part.distance(samples)
    cosine = np.abs((turned * part.normals_near(samples)).sum(1)).clip(0, 1)
    surface = trimesh.sample.sample_surface(part.mesh, SAMPLES, seed=0)[0]
    back = scene_of(made).compute_distance(tensor(surface)).numpy()
    figures = {
        "mesh to surface x 1e3": float(away.mean() * 1e3),
        "surface to mesh x 1e3": float(back.mean() * 1e3),
        "mesh normals, degrees": float(np.degrees(np.arccos(cosine)).mean()),
    }
    return Outcome(figures, (samples, turned, error_colours(away, 0.01)))


def registration(first: tuple[Floats, Floats], second: tuple[Floats, Floats], pose: Floats) -> Outcome:
    """ICP from a rough pose, to points and to planes; ``pose`` (4, 4) takes the second scan to the first."""
    figures = {}
    kinds = open3d.pipelines.registration
    moved = second[0]
    for name, estimation in (
        ("points", kinds.TransformationEstimationPointToPoint()),
        ("planes", kinds.TransformationEstimationPointToPlane()),
    ):
        criteria = kinds.ICPConvergenceCriteria(max_iteration=100)
        found = kinds.registration_icp(
            cloud_of(*second), cloud_of(*first), REACH, np.eye(4), estimation, criteria
        ).transformation
        turn = Rotation.from_matrix(found[:3, :3] @ pose[:3, :3].T)
        middle = second[0].mean(axis=0)
        slip = (found - pose)[:3, :3] @ middle + (found - pose)[:3, 3]
        figures[f"ICP to {name}: rotation, degrees"] = float(np.degrees(turn.magnitude()))
        figures[f"ICP to {name}: translation x 1e3"] = float(np.linalg.norm(slip) * 1e3)
        moved = second[0] @ found[:3, :3].T + found[:3, 3]
        turned = second[1] @ found[:3, :3].T
    colours = np.repeat([[0.95, 0.65, 0.25], [0.3, 0.6, 0.95]], [len(first[0]), len(moved)], axis=0)
    return Outcome(figures, (np.concatenate([first[0], moved]), np.concatenate([first[1], turned]), colours))


def plane_fitting(part: Part, scan: Scan, points: Floats, normals: Floats) -> Outcome:
    """The largest planes one after another (RANSAC), each against the facet most of its points come from."""
    left, angles, found, belong = np.arange(len(points)), [], [], []
    colours = np.full((len(points), 3), 0.75)
    palette = np.array([[0.9, 0.3, 0.3], [0.3, 0.7, 0.35], [0.3, 0.5, 0.9], [0.95, 0.75, 0.2], [0.65, 0.4, 0.85]])
    open3d.utility.random.seed(0)
    for number in range(PLANES):
        model, inliers = cloud_of(points[left]).segment_plane(THRESHOLD, ransac_n=3, num_iterations=3000)
        chosen = left[np.asarray(inliers)]
        facets = scan.facet[chosen]
        facet = int(np.bincount(facets[facets >= 0]).argmax()) if (facets >= 0).any() else -1
        if facet >= 0:
            cosine = abs(model[:3] @ part.planes[facet, :3]) / np.linalg.norm(model[:3])
            angles.append(np.degrees(np.arccos(min(1.0, cosine))))
            found.append((facets == facet).sum() / (scan.facet == facet).sum())
            belong.append((facets == facet).mean())
        colours[chosen] = palette[number % len(palette)]
        left = np.setdiff1d(left, chosen)
    figures = {
        "plane angle, degrees": float(np.mean(angles)),
        "share of a plane's points found, %": float(100 * np.mean(found)),
        "share of finds that belong, %": float(100 * np.mean(belong)),
    }
    return Outcome(figures, (points, normals, colours))


def run(denoise: Denoise, *, points: int, noise: float) -> dict[str, list[Outcome]]:
    """Every application on the noisy and on the denoised scans.

    Parameters
    ----------
    denoise : callable
        Points (N, 3) to denoised points and normals.
    points : int
        Of a whole scan.
    noise : float
        Per cent of the diagonal.
    """
    part = Part()
    rebuilt: list[list[Outcome]] = []
    planes: list[list[Outcome]] = []
    for seed in range(1, 1 + SCANS):
        scan = part.sample(points, noise, seed)
        after_points, after_normals = denoise(scan.points)
        inputs = [(scan.points, scan.normals), (after_points, outward(after_normals, part.normals_near(scan.clean)))]
        rebuilt.append([reconstruction(part, *given) for given in inputs])
        planes.append([plane_fitting(part, scan, *given) for given in inputs])
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(np.radians(TURN) * np.array([3.0, 8, 5]) / np.sqrt(98)).as_matrix()
    pose[:3, 3] = SHIFT * np.array([2.0, -3, 1]) / np.sqrt(14)
    margin = (1 - OVERLAP) / 2
    pairs: list[list[Outcome]] = []
    for pair in range(SCANS):
        first = part.sample(points, noise, 2 * pair + 10, (0, 1 - margin))
        second = part.sample(points, noise, 2 * pair + 11, (margin, 1))
        given = [(first.points, first.normals), (second.points, second.normals)]
        pairs.append([])
        for scans in (given, [denoise(scan) for scan, _ in given]):
            there, here = scans
            away = ((here[0] - pose[:3, 3]) @ pose[:3, :3], here[1] @ pose[:3, :3])
            pairs[-1].append(registration(there, away, pose))
    return {
        "Poisson reconstruction": averaged(rebuilt),
        "RANSAC planes": averaged(planes),
        "Registration": averaged(pairs),
    }


def averaged(outcomes: list[list[Outcome]]) -> list[Outcome]:
    """Mean figures before and after over the scans; the first scan is the one that is shown."""
    means = []
    for which, first in enumerate(outcomes[0]):
        figures = {key: float(np.mean([scan[which].figures[key] for scan in outcomes])) for key in first.figures}
        means.append(Outcome(figures, first.shown))
    return means


def table(outcomes: dict[str, list[Outcome]]) -> str:
    """Markdown."""
    lines = ["| application | figure | noisy | denoised |", "|---|---|---|---|"]
    for name, (before, after) in outcomes.items():
        for key, value in before.figures.items():
            lines.append(f"| {name} | {key} | {value:.2f} | {after.figures[key]:.2f} |")
    return "\n".join(lines) + "\n"


def draw(outcomes: dict[str, list[Outcome]], path: Path) -> None:
    """Before above, after below, a column an application."""
    figure = Figure(figsize=(len(outcomes) * PANEL / DPI, 2 * PANEL / DPI), dpi=DPI, layout="constrained")
    for axes, (name, pair) in zip(figure.subplots(2, len(outcomes)).T, outcomes.items(), strict=True):
        camera = view_of(*pair[1].shown[:2])
        for axis, label, outcome in zip(axes, ("noisy", "denoised"), pair, strict=True):
            axis.imshow(shaded(*outcome.shown, camera))
            axis.set_title(f"{name}: {label}", fontsize=8)
            axis.set_axis_off()
    save(figure, path)


def main() -> None:
    """Run all and write the table and the picture."""

    def passes(text: str) -> int | Literal["auto"]:
        return "auto" if text == "auto" else int(text)

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=30_000)
    parser.add_argument("--noise", type=float, default=1.0, help="per cent of the diagonal")
    parser.add_argument("--model", default=DEFAULT_MODEL)
    parser.add_argument("--iterations", type=passes, default="auto", help="a number, or auto")
    parser.add_argument("--output", type=Path, default=Path("runs/applications"))
    arguments = parser.parse_args()
    denoiser = Denoiser.load(arguments.model)

    def denoise(points: Floats) -> tuple[Floats, Floats]:
        result = denoiser.denoise(points, iterations=arguments.iterations)
        return result.points, result.normals.astype(np.float64)

    arguments.output.mkdir(parents=True, exist_ok=True)
    outcomes = run(denoise, points=arguments.points, noise=arguments.noise)
    (arguments.output / "applications.md").write_text(table(outcomes))
    draw(outcomes, arguments.output / "applications.png")
    print(table(outcomes))


if __name__ == "__main__":
    main()
