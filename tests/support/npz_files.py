"""What the tests of the format are made of."""

from __future__ import annotations

import io
import struct
import zipfile
from collections.abc import Callable
from typing import Any

import numpy as np

from pcdnf.formats import FormatError

Refused = Callable[..., FormatError]
POINTS = np.arange(12, dtype=np.float32).reshape(4, 3)


def npz(**arrays: Any) -> bytes:
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def npy(array: Any) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def archive(*members: tuple[str, bytes], method: int = zipfile.ZIP_STORED) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as target:
        for name, data in members:
            target.writestr(zipfile.ZipInfo(name), data, compress_type=method)
    return file.getvalue()


def with_header(literal: bytes, body: bytes, version: int = 1) -> bytes:
    length = struct.pack("<H" if version == 1 else "<I", len(literal))
    return archive(("points.npy", b"\x93NUMPY" + bytes([version, 0]) + length + literal + body))


def patched(data: bytes, **fields: int) -> bytes:
    """An archive with fields of its first directory entry changed."""
    places = {
        "flags": (8, "H"),
        "method": (10, "H"),
        "crc": (16, "I"),
        "packed": (20, "I"),
        "size": (24, "I"),
        "offset": (42, "I"),
    }
    changed = bytearray(data)
    entry = data.index(b"PK\x01\x02")
    for name, value in fields.items():
        place, code = places[name]
        struct.pack_into(f"<{code}", changed, entry + place, value)
    return bytes(changed)
