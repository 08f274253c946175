"""A folder of results: a line of JSON for each row, and the cloud that came out.

A row is found again by what it depends on: the input's bytes and the method's identity (weights, versions, device).
What is there is not computed again. A line is written after its cloud, so a kill loses the run under way and no more.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..errors import PcdnfError
from .choice import Choice
from .methods import Method, Output

Floats = NDArray[np.float64]
Extent = tuple[Floats, float]
"""Lowest corner (3,) and diagonal of a bounding box, in the cloud's unit."""

KEY_LENGTH = 20
"""Hexadecimal digits of a key."""


class Keyed(Protocol):
    """A dataclass that knows what it depends on."""

    @property
    def key(self) -> str:
        """Hash of the input and the method's identity; names the file in ``clouds/``."""


Row = TypeVar("Row", bound=Keyed)


class Ledger(Generic[Row]):
    """Rows of one kind and their clouds.

    Parameters
    ----------
    folder : Path
        Made where it does not exist.
    name : str
        Of the file of lines in it.
    row : type
        The dataclass of a line.
    fresh : bool
        Compute again what is there.

    Raises
    ------
    PcdnfError
        ``unwritable_folder``.
    """

    def __init__(self, folder: Path, name: str, row: type[Row], *, fresh: bool = False) -> None:
        self._clouds = _made(folder / "clouds")
        self._file = folder / name
        self._known = {found.key: found for found in (row(**json.loads(line)) for line in _whole_lines(self._file))}
        self._fresh = fresh

    def row(
        self,
        digest: str,
        method: Method | Choice,
        compute: Callable[[Method | Choice, str], tuple[Row, Output]],
        extent: Extent,
    ) -> tuple[Row, bool]:
        """Return the row of a method on one input, and whether it was computed just now.

        Parameters
        ----------
        digest : str
            Of the input, see :func:`digest_of`.
        method : Method or Choice
        compute : callable
            Returns the row and the cloud for a method and a key.
        extent : (ndarray, float)
            By which the cloud is stored.
        """
        key = key_of(digest, method.identity)
        known = None if self._fresh else self._known.get(key)
        if known is not None and self._cloud_file(key).exists():
            return known, False
        row, output = compute(method, key)
        self._store(key, output, extent)
        with self._file.open("a") as lines:
            lines.write(json.dumps(vars(row)) + "\n")
            lines.flush()
            os.fsync(lines.fileno())
        self._known[key] = row
        return row, True

    def output(self, key: str, extent: Extent) -> Output:
        """Read the cloud of a key, in the unit of its input; stored as float32 shares of the diagonal."""
        low, diagonal = extent
        with np.load(self._cloud_file(key), allow_pickle=False) as arrays:
            return Output(arrays["points"].astype(np.float64) * diagonal + low, arrays["normals"])

    def _cloud_file(self, key: str) -> Path:
        return self._clouds / f"{key}.npz"

    def _store(self, key: str, output: Output, extent: Extent) -> None:
        low, diagonal = extent
        points = ((output.points - low) / diagonal).astype(np.float32)
        temporary = self._clouds / f"{key}.{os.getpid()}.tmp"
        with temporary.open("wb") as file:
            np.savez(file, points=points, normals=output.normals.astype(np.float32))
        temporary.replace(self._cloud_file(key))


def extent_of(points: Floats) -> Extent:
    """Return lowest corner and diagonal of points (N, 3)."""
    low = points.min(axis=0)
    return low, float(np.linalg.norm(points.max(axis=0) - low))


def digest_of(*arrays: Floats | None) -> str:
    """SHA-256 of arrays."""
    total = hashlib.sha256()
    for array in arrays:
        total.update(b"none" if array is None else np.ascontiguousarray(array, "<f8").tobytes())
    return total.hexdigest()


def key_of(digest: str, identity: dict[str, str]) -> str:
    """Return the key of a method's result on an input."""
    text = json.dumps({"input": digest, **identity}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:KEY_LENGTH]


def _made(folder: Path) -> Path:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise PcdnfError(
            f"The folder {folder.parent} cannot be created: {error.strerror}.",
            code="unwritable_folder",
            hint="Name another folder.",
        ) from error
    return folder


def _whole_lines(file: Path) -> list[bytes]:
    """Return the lines of a file; half a line at its end, left by a kill, is cut off."""
    if not file.exists():
        return []
    text = file.read_bytes()
    whole = text[: text.rfind(b"\n") + 1]
    if whole != text:
        os.truncate(file, len(whole))
    return whole.splitlines()
