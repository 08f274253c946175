#!/usr/bin/env bash
# One would expect: a vertex of an OFF with normals and colours has its normal first, then its colour. Geomview, whose
# format it is, defines "x y z [nx ny nz] [r g b a]" whatever the order of the letters in the first word.
# What happens (pymeshlab 2025.7.post1): the first word is NCOFF, and the colour stands between the point and the normal.
# A reader that follows the definition takes 0 to 255 for normals.
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

points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
normals = np.tile([0.0, 0, 1], (3, 1))
colours = np.tile([200, 100, 50, 255], (3, 1)) / 255
mesh = pymeshlab.Mesh(points, np.array([[0, 1, 2]]), v_normals_matrix=normals, v_color_matrix=colours)
meshes = pymeshlab.MeshSet()
meshes.add_mesh(mesh)
meshes.save_current_mesh("triangle.off", save_vertex_normal=True, save_vertex_color=True)
with open("triangle.off") as file:
    lines = [line.split("#")[0].split() for line in file]
words = [line for line in lines if line]
first = [float(word) for word in words[2]]
print("pymeshlab", version("pymeshlab"))
print("first word:", words[0][0], " first vertex:", first)
expected = words[0][0] == "NCOFF" and first[3:7] == [200, 100, 50, 255] and first[7:9] == [0, 0] and first[9] > 0
sys.exit(0 if expected else "the behaviour has changed")
PYTHON
