"""The arrays through which libE57 reads and writes the fields of a scan."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_NARROW = ("b", "B", "h", "H", "f", "d")


class Buffers:
    """Named arrays of one scan, kept for as long as libE57 may use them.

    libE57 is given pointers. Its binding keeps no reference to the arrays behind them, so an array that Python frees
    earlier is read, or written, as whatever takes its place.

    Parameters
    ----------
    image : libe57.ImageFile
        The open file.
    count : int
        Values in each array.
    """

    def __init__(self, image: Any, count: int) -> None:
        from pye57 import libe57

        self._image = image
        self._count = count
        self._make = libe57.SourceDestBuffer
        self._arrays: dict[str, NDArray[Any]] = {}
        self.vector = libe57.VectorSourceDestBuffer()

    def add(self, path: str, values: NDArray[Any]) -> NDArray[Any]:
        """Add the field at ``path``; the array, (count,), that libE57 uses in its place.

        Integers wider than 16 bits go through C's ``long long``: the binding refuses ``int`` and takes ``long``,
        which is numpy's int64 on Linux, for 32 bits.

        Raises
        ------
        ValueError
            If ``values`` has another length.
        """
        if values.shape != (self._count,):
            raise ValueError(f"the field {path} has shape {values.shape}, expected ({self._count},)")
        kind = values.dtype.char if values.dtype.char in _NARROW else np.dtype(np.longlong).char
        array = np.ascontiguousarray(values, dtype=kind)
        self._arrays[path] = array
        self.vector.append(self._make(self._image, path, array, self._count, True, True))
        return array
