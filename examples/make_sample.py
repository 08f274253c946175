"""Make the sample clouds of this folder: a machined bracket, clean and as a scanner would see it.

    python examples/make_sample.py

``bracket_clean.ply`` has exact normals; ``bracket_noisy.ply`` the same points with Gaussian noise of 0.7 % of the
diagonal and painted colours, which the page at ``/`` offers too. Millimetres,
float32. Needs the ``train`` extra (manifold3d, trimesh).
"""

from __future__ import annotations

from pathlib import Path

import manifold3d
import numpy as np
import trimesh

from pcdnf.formats import PointCloud, write

POINTS = 40_000
NOISE = 0.007
FOLDER = Path(__file__).parent
VIEWER = FOLDER.parent / "service" / "viewer"


def bracket() -> trimesh.Trimesh:
    """An L-shaped bracket with a boss, a rib, bores and a dome, in millimetres."""
    solid = manifold3d.Manifold
    part = solid.cube((120, 80, 14)) + solid.cube((14, 80, 90))
    part += solid.cylinder(30, 24, 20, 200).translate((78, 40, 10))
    part -= solid.cylinder(80, 12, -1, 200).translate((78, 40, -10))
    part += solid.sphere(20, 200).translate((14, 40, 60))
    wedge = manifold3d.CrossSection([np.array([[0.0, 0.0], [44, 0], [0, 44]])])
    for y in (4.0, 68.0):
        part += solid.extrude(wedge, 8).rotate((90, 0, 0)).translate((12, y + 8, 12))
    for x, y in ((106, 14), (106, 66), (44, 40)):
        part -= solid.cylinder(40, 5.5, -1, 120).translate((x, y, -10))
    for y in (14.0, 66.0):
        part -= solid.cylinder(60, 6, -1, 120).rotate((0, 90, 0)).translate((-20, y, 76))
    mesh = part.to_mesh()
    return trimesh.Trimesh(mesh.vert_properties[:, :3], mesh.tri_verts, process=True)


def main() -> None:
    """Write both files."""
    mesh = bracket()
    points, faces = trimesh.sample.sample_surface(mesh, POINTS, seed=1)
    normals = mesh.face_normals[faces]
    rng = np.random.default_rng(2)
    noisy = points + rng.normal(size=points.shape) * NOISE * np.linalg.norm(np.ptp(points, axis=0))
    share = ((points - points.min(0)) / np.ptp(points, axis=0)).clip(0, 1)
    colour = (np.array([70, 95, 120]) + share[:, 2:] * np.array([150, 90, -10])).clip(0, 255).astype(np.uint8)
    clean = PointCloud(points=points.astype(np.float32), normals=normals.astype(np.float32))
    write(FOLDER / "bracket_clean.ply", clean)
    painted = {name: colour[:, axis] for axis, name in enumerate(("red", "green", "blue"))}
    for path in (FOLDER / "bracket_noisy.ply", VIEWER / "sample.ply"):
        write(path, PointCloud(points=noisy.astype(np.float32), attributes=painted))


if __name__ == "__main__":
    main()
