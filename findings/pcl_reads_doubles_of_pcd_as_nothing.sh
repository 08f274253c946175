#!/usr/bin/env bash
# One would expect: a PCD whose x, y and z are of 8 bytes, which the format allows (SIZE 8, TYPE F), is read, or refused
# with an error and a status that is not 0.
# What happens (Open3D 0.19.0, and PCL 1.13 where its tools are installed): Open3D's legacy reader returns the right
# number of points, all of them 0 0 0, without a warning. pcl_voxel_grid writes an empty cloud and ends with status 0.
# The same points as float (SIZE 4) are read rightly by both.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check open3d==0.19.0 numpy==1.26.4
venv/bin/python - <<'PYTHON'
import shutil
import subprocess
import sys

import numpy as np
import open3d

points = np.random.default_rng(0).uniform(1, 9, (500, 3))


def pcd(path, size):
    """Write the points as a binary PCD with coordinates of 4 or 8 bytes."""
    head = f"# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE {size} {size} {size}\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 500\n"
    head += "HEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 500\nDATA binary\n"
    with open(path, "wb") as file:
        file.write(head.encode() + points.astype(f"<f{size}").tobytes())


print("Open3D", open3d.__version__)
off = {}
for size in (4, 8):
    pcd(f"{size}.pcd", size)
    read = np.asarray(open3d.io.read_point_cloud(f"{size}.pcd").points)
    off[size] = float(np.abs(read - points).max())
    print(f"{size} bytes: {len(read)} points, off by {off[size]:.3g}, first {read[0].tolist()}")
left = {}
if shutil.which("pcl_voxel_grid"):
    for size in (4, 8):
        done = subprocess.run(["pcl_voxel_grid", f"{size}.pcd", "out.pcd", "-leaf", "0.1,0.1,0.1"], capture_output=True)
        with open("out.pcd", "rb") as file:
            left[size] = int(file.read().split(b"POINTS ")[1].split()[0])
        print(f"pcl_voxel_grid, {size} bytes: status {done.returncode}, {left[size]} points")
else:
    print("pcl_voxel_grid is not installed; only Open3D was tried")
expected = off[4] < 1e-5 and off[8] > 1 and (not left or (left[4] > 0 and left[8] == 0))
sys.exit(0 if expected else "the behaviour has changed")
PYTHON
