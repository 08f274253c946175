"""The preview of a finished job: a binary glTF with at most a million points.

It has two meshes of points, ``before`` and ``after``. Both are in the same random order, so any prefix is a fair sample
of the cloud. Coordinates are centred and stored as float32, normals as signed bytes (``KHR_mesh_quantization``).
``extras`` has the figures of the whole cloud, computed in float64.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcdnf.formats import PointCloud

DISPLAY_POINTS = 1_000_000
BINS = 64
TAIL = 0.01  # share of points outside the box of the view, at either end of each axis
_ORDER_SEED = 0

_COLOUR_COLUMNS = (("red", "green", "blue"), ("r", "g", "b"), ("diffuse_red", "diffuse_green", "diffuse_blue"))
_COLOUR_ARRAYS = ("colors", "colours", "color", "colour", "rgb")
_POINTS, _ARRAY_BUFFER = 0, 34962
_BYTE, _UBYTE, _FLOAT = 5120, 5121, 5126
_KINDS = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}


def colours(cloud: PointCloud) -> NDArray[np.uint8] | None:
    """Return the colours (N, 3) of a file in the usual column names, or None if it has none.

    Integers of 16 bits keep their upper byte; floats range from 0 to 1, or from 0 to 255 if one exceeds 1.
    """
    found: NDArray[Any] | None = None
    for names in _COLOUR_COLUMNS:
        columns = [cloud.attributes.get(name) for name in names]
        if all(column is not None and column.ndim == 1 for column in columns):
            found = np.stack([column for column in columns if column is not None], axis=1)
            break
    for name in _COLOUR_ARRAYS:
        column = cloud.attributes.get(name)
        if found is None and column is not None and column.ndim == 2 and column.shape[1] in (3, 4):
            found = column[:, :3]
    if found is None or found.dtype.kind not in "uif":
        return None
    if found.dtype == np.uint8:
        return found
    values = np.nan_to_num(found.astype(np.float64))
    if found.dtype.kind == "f":
        values *= 255.0 if values.max(initial=0.0) <= 1.0 else 1.0
    elif values.max(initial=0.0) > 255:
        values /= 257.0
    return values.clip(0, 255).round().astype(np.uint8)


def write_display(
    path: Path,
    *,
    before: NDArray[np.floating],
    after: NDArray[np.floating],
    raw_normals: NDArray[np.floating],
    normals: NDArray[np.floating],
    colour: NDArray[np.uint8] | None,
    shares: dict[str, float] | None = None,
) -> None:
    """Write the display file of a job.

    Parameters
    ----------
    path : Path
    before, after : ndarray, (N, 3) float
        Coordinates of the upload and of the result, in the file's unit.
    raw_normals, normals : ndarray, (N, 3) float
        Unit normals of the upload and of the result.
    colour : ndarray, (N, 3) uint8, optional
        The file's colours.
    shares : dict of float, optional
        See :meth:`pcdnf.inference.diagnostics.Diagnostics.shares`.
    """
    count = len(before)
    rows = np.random.default_rng(_ORDER_SEED).permutation(count)[:DISPLAY_POINTS]
    low, high = np.quantile(np.asarray(before, np.float64), (TAIL, 1 - TAIL), axis=0)
    centre = low + (high - low) / 2
    moved = np.linalg.norm(np.asarray(after, np.float64) - before, axis=1)
    mesh: dict[str, dict[str, NDArray[Any]]] = {
        "before": {"POSITION": _centred(before[rows], centre), "NORMAL": _bytes(raw_normals[rows])},
        "after": {
            "POSITION": _centred(after[rows], centre),
            "NORMAL": _bytes(normals[rows]),
            "_DISPLACEMENT": moved[rows].astype("<f4"),
        },
    }
    if colour is not None:
        opaque = np.full((len(rows), 4), 255, np.uint8)
        opaque[:, :3] = colour[rows]
        mesh["before"]["COLOR_0"] = opaque
    extras = {
        "points": count,
        "centre": centre.tolist(),
        "box": [(low - centre).tolist(), (high - centre).tolist()],
        "displacement": _statistics(moved),
    }
    if shares is not None:
        extras["shares"] = shares
    _write_glb(path, mesh, extras)


def _centred(points: NDArray[np.floating], centre: NDArray[np.float64]) -> NDArray[np.float32]:
    return (np.asarray(points, np.float64) - centre).astype("<f4")


def _bytes(normals: NDArray[np.floating]) -> NDArray[np.int8]:
    """Return normals (N, 3) as (N, 4) signed bytes: a stride of four, as WebGL wants it, the last one unused."""
    packed = np.zeros((len(normals), 4), np.int8)
    packed[:, :3] = np.rint(np.asarray(normals, np.float64) * 127).clip(-127, 127)
    return packed


def _statistics(moved: NDArray[np.float64]) -> dict[str, Any]:
    median, p95, p99 = np.quantile(moved, (0.5, 0.95, 0.99)).tolist()
    counts, _ = np.histogram(moved, BINS, (0.0, p99 or 1.0))
    return {
        "mean": float(moved.mean()),
        "median": median,
        "p95": p95,
        "p99": p99,
        "max": float(moved.max()),
        "histogram": counts.tolist(),  # of 0 to p99, in equal steps
    }


def _write_glb(path: Path, meshes: dict[str, dict[str, NDArray[Any]]], extras: dict[str, Any]) -> None:
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    arrays: list[NDArray[Any]] = []
    document = {
        "asset": {"version": "2.0", "generator": "pcdnf", "extras": extras},
        "extensionsUsed": ["KHR_mesh_quantization"],
        "extensionsRequired": ["KHR_mesh_quantization"],
        "scene": 0,
        "scenes": [{"nodes": list(range(len(meshes)))}],
        "nodes": [{"name": name, "mesh": index} for index, name in enumerate(meshes)],
        "meshes": [],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [],
    }
    offset = 0
    for name, attributes in meshes.items():
        indices = {}
        for attribute, array in attributes.items():
            stride = array.strides[0]
            indices[attribute] = len(accessors)
            accessors.append(_accessor(attribute, array, len(views)))
            views.append(
                {
                    "buffer": 0,
                    "byteOffset": offset,
                    "byteLength": array.nbytes,
                    "byteStride": stride,
                    "target": _ARRAY_BUFFER,
                }
            )
            arrays.append(array)
            offset += array.nbytes
        document["meshes"].append({"name": name, "primitives": [{"mode": _POINTS, "attributes": indices}]})  # type: ignore[attr-defined]
    document["buffers"] = [{"byteLength": offset}]
    head = json.dumps(document, separators=(",", ":")).encode()
    head += b" " * (-len(head) % 4)
    with path.open("wb") as file:
        file.write(struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(head) + 8 + offset))
        file.write(struct.pack("<I4s", len(head), b"JSON") + head)
        file.write(struct.pack("<I4s", offset, b"BIN\0"))
        for array in arrays:
            file.write(np.ascontiguousarray(array).data)


def _accessor(attribute: str, array: NDArray[Any], view: int) -> dict[str, Any]:
    component = {"b": _BYTE, "B": _UBYTE, "f": _FLOAT}[array.dtype.char]
    width = 1 if array.ndim == 1 else array.shape[1]
    accessor: dict[str, Any] = {
        "bufferView": view,
        "componentType": component,
        "count": len(array),
        "type": "VEC3" if attribute == "NORMAL" else _KINDS[width],
    }
    if component != _FLOAT:
        accessor["normalized"] = True
    if attribute == "POSITION":
        accessor |= {"min": array.min(0).tolist(), "max": array.max(0).tolist()}
    return accessor
