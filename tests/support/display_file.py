"""A reader of display files for the tests, by the letter of glTF 2.0."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_TYPES = {5120: np.int8, 5121: np.uint8, 5126: np.float32}


def read_display(path: Path) -> tuple[dict[str, Any], dict[str, dict[str, NDArray[Any]]]]:
    """Return the JSON and, by mesh and attribute, the arrays."""
    data = path.read_bytes()
    magic, version, size = struct.unpack_from("<4sII", data)
    assert (magic, version, size) == (b"glTF", 2, len(data))
    length, kind = struct.unpack_from("<I4s", data, 12)
    assert kind == b"JSON"
    assert length % 4 == 0
    document = json.loads(data[20 : 20 + length])
    binary, kind = struct.unpack_from("<I4s", data, 20 + length)
    assert kind == b"BIN\0"
    assert 28 + length + binary == len(data)
    assert binary % 4 == 0
    meshes: dict[str, dict[str, NDArray[Any]]] = {}
    for mesh in document["meshes"]:
        (primitive,) = mesh["primitives"]
        assert primitive["mode"] == 0
        meshes[mesh["name"]] = {}
        for name, index in primitive["attributes"].items():
            accessor = document["accessors"][index]
            view = document["bufferViews"][accessor["bufferView"]]
            width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
            dtype = np.dtype(_TYPES[accessor["componentType"]])
            stride = view["byteStride"]
            assert view["byteOffset"] % 4 == stride % 4 == 0
            assert view["byteLength"] == stride * accessor["count"]
            rows = np.frombuffer(data, np.uint8, view["byteLength"], 28 + length + view["byteOffset"])
            values = rows.reshape(-1, stride)[:, : width * dtype.itemsize].copy().view(dtype)
            meshes[mesh["name"]][name] = values[:, 0] if width == 1 else values
            if name == "POSITION":
                assert accessor["min"] == values.min(0).tolist()
                assert accessor["max"] == values.max(0).tolist()
    return document, meshes
