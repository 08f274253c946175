#!/usr/bin/env bash
# One would expect: `confidence`, the column of the Stanford scans, becomes the scalar of a vertex, as MeshLab's importer
# says it does and as it does with `quality`.
# What happens (pymeshlab 2025.7.post1): the mesh has a scalar with other numbers, such as 5e-315 or 1.0000002 in place of
# 0.1. The bits of the float are in one half of a double; the other half is whatever was there. The same numbers named
# `quality` are right. There is no warning.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check pymeshlab==2025.7.post1 numpy==1.26.4
venv/bin/python - <<'PYTHON'
import sys
from importlib.metadata import version

import numpy as np
import pymeshlab

values = np.linspace(0.1, 1, 500)


def scalar(name):
    """Return what MeshLab has as the scalar of the vertices of a PLY with one more column."""
    head = f"ply\nformat ascii 1.0\nelement vertex {len(values)}\n"
    head += "".join(f"property float {one}\n" for one in ("x", "y", "z", name)) + "end_header\n"
    with open("cloud.ply", "w") as file:
        file.write(head + "".join(f"{i} {i % 7} {i % 3} {value:.9g}\n" for i, value in enumerate(values)))
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh("cloud.ply")
    mesh = meshes.current_mesh()
    return np.array(mesh.vertex_scalar_array(), copy=True) if mesh.has_vertex_scalar() else None


print("pymeshlab", version("pymeshlab"))
found = {name: scalar(name) for name in ("quality", "confidence")}
print("written:", values[:2].tolist(), "…", values[-1])
for name, column in found.items():
    print(f"{name}:", None if column is None else [*column[:2].tolist(), "…", float(column[-1])])
right, wrong = found["quality"], found["confidence"]
expected = right is not None and np.abs(right - values).max() < 1e-6
expected = expected and wrong is not None and np.abs(wrong - values).max() > 0.1
sys.exit(0 if expected else "the behaviour has changed")
PYTHON
