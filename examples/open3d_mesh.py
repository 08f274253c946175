"""From a noisy scan to a mesh: PCDNF's points and normals into Open3D's Poisson reconstruction.

pip install open3d
python examples/open3d_mesh.py examples/bracket_noisy.ply mesh.ply
"""

from __future__ import annotations

import sys

import numpy as np
import open3d as o3d

from pcdnf import Denoiser
from pcdnf.formats import read

DEPTH = 8
"""Of the octree: each level doubles the resolution."""
SPARSEST = 0.02
"""Share of the vertices, those with the fewest points near, that is cut off: Poisson closes every hole."""


def main() -> None:
    """Denoise, orient, reconstruct."""
    source, target = sys.argv[1:3]
    cloud = read(source)
    result = Denoiser.load().denoise(cloud.points, iterations=2)
    centre = result.points.mean(axis=0)  # Open3D's octree works in float32: far coordinates lose their digits
    points = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(result.points - centre))
    points.normals = o3d.utility.Vector3dVector(result.normals.astype(np.float64))
    # The direction of a PCDNF normal is right up to its sign; a mesh needs all of them to point outwards.
    points.orient_normals_consistent_tangent_plane(20)
    mesh, density = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(points, depth=DEPTH, n_threads=1)
    sparse = np.asarray(density) < np.quantile(np.asarray(density), SPARSEST)
    mesh.remove_vertices_by_mask(sparse)
    mesh.translate(centre)
    o3d.io.write_triangle_mesh(target, mesh)
    print(f"{len(result.points):,} points, {len(mesh.triangles):,} triangles: {target}")


if __name__ == "__main__":
    main()
