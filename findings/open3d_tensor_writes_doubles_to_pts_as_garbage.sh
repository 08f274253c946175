#!/usr/bin/env bash
# One would expect: open3d.t.io.write_point_cloud writes a cloud of float64 positions to PTS as numbers that are near
# them, or returns False.
# What happens (Open3D 0.19.0): it returns True, and the rows hold other numbers, of any size: the doubles are read as
# if they were floats. Positions of float32 are written rightly, and the legacy open3d.io writes doubles rightly.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check open3d==0.19.0 numpy==1.26.4
venv/bin/python - <<'PYTHON'
import sys

import numpy as np
import open3d

points = np.random.default_rng(0).uniform(1, 9, (200, 3))
print("Open3D", open3d.__version__)


def off(path):
    """How far the rows of a PTS are from the points."""
    with open(path) as file:
        rows = [line.split() for line in file.read().splitlines()[1:] if line.strip()]
    table = np.array(rows, float)
    return float(np.abs(np.nan_to_num(table, nan=1e9) - points).max())


found = {}
for kind in ("float32", "float64"):
    cloud = open3d.t.geometry.PointCloud(open3d.core.Tensor(points.astype(kind)))
    done = open3d.t.io.write_point_cloud(f"{kind}.pts", cloud)
    found[kind] = (done, off(f"{kind}.pts"))
    print(f"tensor, {kind}: returned {done}, off by {found[kind][1]:.3g}")
legacy = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
open3d.io.write_point_cloud("legacy.pts", legacy)
print(f"legacy, float64: off by {off('legacy.pts'):.3g}")
expected = found["float32"][1] < 1e-5 and found["float64"][0] and found["float64"][1] > 1 and off("legacy.pts") < 1e-5
sys.exit(0 if expected else "the behaviour has changed")
PYTHON
