"""What the tests of the format are made of."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pcdnf.formats import FormatError

Refused = Callable[..., FormatError]
XYZ = ("float x", "float y", "float z")


def header(*lines: str, encoding: str = "binary_little_endian", newline: str = "\n") -> bytes:
    return "".join(f"{line}{newline}" for line in ("ply", f"format {encoding} 1.0", *lines, "end_header")).encode()


def vertices(count: object, *properties: str) -> list[str]:
    return [f"element vertex {count}", *(f"property {prop}" for prop in properties or XYZ)]


def floats(count: int) -> bytes:
    return np.arange(3 * count, dtype="<f4").tobytes()
