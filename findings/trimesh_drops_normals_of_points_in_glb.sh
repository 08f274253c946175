#!/usr/bin/env bash
# One would expect: points of a GLB (primitives of mode POINTS) come with their normals, or a warning says that they do
# not. Triangles with the same accessors do.
# What happens (trimesh 5.2.0): the points and their colours are read. NORMAL and attributes of the file's own (_INTENSITY)
# are gone without a word, and `trimesh.PointCloud` has no place for them. For triangles both are kept.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check trimesh==5.2.0 numpy==1.26.4
venv/bin/python - <<'PYTHON' 2>&1
import io
import json
import logging
import struct
import sys

import numpy as np
import trimesh

logging.basicConfig(level=logging.WARNING)
COUNT = 60
rng = np.random.default_rng(0)
normals = rng.normal(size=(COUNT, 3))
normals = (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype("<f4")
points, intensity = (5 * normals).astype("<f4"), np.arange(COUNT, dtype="<f4")
colours = rng.integers(0, 256, (COUNT, 4)).astype("u1")


def glb(mode):
    """Return a binary glTF with one primitive."""
    arrays = {"POSITION": points, "NORMAL": normals, "COLOR_0": colours, "_INTENSITY": intensity}
    accessors, views, data = [], [], b""
    for number, array in enumerate(arrays.values()):
        kind = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[array.reshape(COUNT, -1).shape[1]]
        accessor = {"bufferView": number, "count": COUNT, "type": kind, "componentType": 5126}
        if array is points:
            accessor |= {"min": array.min(0).tolist(), "max": array.max(0).tolist()}
        if array is colours:
            accessor |= {"componentType": 5121, "normalized": True}
        accessors.append(accessor)
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": array.nbytes})
        data += array.tobytes()
    primitive = {"attributes": {name: number for number, name in enumerate(arrays)}, "mode": mode}
    scene = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
             "meshes": [{"primitives": [primitive]}], "accessors": accessors, "bufferViews": views,
             "buffers": [{"byteLength": len(data)}]}
    text = json.dumps(scene).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def found(mode):
    """Return what trimesh has of each attribute."""
    (geometry,) = trimesh.load(io.BytesIO(glb(mode)), file_type="glb", process=False).geometry.values()
    has = {"points": np.abs(geometry.vertices - points).max() < 1e-6}
    kept = getattr(geometry, "vertex_normals", np.empty((0, 3)))
    has["normals"] = len(kept) == COUNT and bool(np.abs(kept - normals).max() < 1e-3)
    own = {**getattr(geometry, "vertex_attributes", {}), **geometry.metadata}
    has["_INTENSITY"] = any("intensity" in str(name).lower() for name in own)
    print(f"{type(geometry).__name__}: {has}")
    return has


print("trimesh", trimesh.__version__)
cloud, mesh = found(0), found(4)
expected = cloud["points"] and not cloud["normals"] and not cloud["_INTENSITY"] and mesh["normals"] and mesh["_INTENSITY"]
sys.exit(0 if expected else "the behaviour has changed")
PYTHON
