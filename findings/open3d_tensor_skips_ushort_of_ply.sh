#!/usr/bin/env bash
# One would expect: `ushort` and `uint16` are two names of one PLY type, and readers take both.
# What happens (Open3D 0.19.0, meshio 5.3.5): Open3D's tensor reader prints a warning on `ushort` and leaves the property
# out, and reads `uint16`. meshio raises KeyError('ushort') and reads `uint16`. The older names `uchar`, `int`, `float`
# are fine in both.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check open3d==0.19.0 meshio==5.3.5 numpy==1.26.4
venv/bin/python - <<'PYTHON'
import importlib.metadata
import sys

import meshio
import numpy as np
import open3d

rows = np.zeros(50, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<u2")])
rows["x"], rows["y"], rows["intensity"] = np.arange(50), np.arange(50) % 7, np.arange(50) * 100
print("Open3D", open3d.__version__, "meshio", importlib.metadata.version("meshio"))
found = {}
for spelled in ("ushort", "uint16"):
    head = "ply\nformat binary_little_endian 1.0\nelement vertex 50\nproperty float x\nproperty float y\n"
    head += f"property float z\nproperty {spelled} intensity\nend_header\n"
    with open("a.ply", "wb") as file:
        file.write(head.encode() + rows.tobytes())
    tensor = "intensity" in open3d.t.io.read_point_cloud("a.ply").point
    try:
        mesh = "intensity" in meshio.read("a.ply").point_data
    except KeyError as error:
        mesh = f"KeyError({error})"
    found[spelled] = (tensor, mesh)
    print(f"{spelled}: Open3D has the intensity: {tensor}; meshio: {mesh}")
expected = found == {"ushort": (False, "KeyError('ushort')"), "uint16": (True, True)}
sys.exit(0 if expected else "the behaviour has changed")
PYTHON
