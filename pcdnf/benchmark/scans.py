"""Scans with their truth: simulated anew, or read from a folder; and how far a result is from it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import PcdnfError
from ..scanners.catalog import KINDS, simulate
from ..scanners.scan import Scan, load_scan
from ..scanners.surface import Surface
from .methods import Output

Floats = NDArray[np.float64]

FIRST_SEED = 3_000_000
"""Of simulated scans: neither trained on nor validated on."""
SCALE = 1000.0
"""Distances are shown in thousandths of a scan's unit."""
UNITS = {"m": "mm", "mm": "um", "diag": "1e-3"}


@dataclass(frozen=True)
class ScanScore:
    """What became of a scan; points that are ``mixed`` have no truth and do not count.

    Attributes
    ----------
    distance : float
        Mean distance to the true mesh, thousandths of the scan's unit.
    worse, worse_by_sigma : float or None
        Shares of points that are further from the mesh than before, and by more than their own sigma; None where
        the method changes the number of points.
    thin, thin_worse : float or None
        Mean distance of the points of thin parts, and their share that is worse by more than their sigma.
    angle : float
        Mean angle to the true normals, degrees, up to sign.
    points : int
        That came out.
    """

    distance: float
    worse: float | None
    worse_by_sigma: float | None
    thin: float | None
    thin_worse: float | None
    angle: float
    points: int


class TrueScan:
    """A scan and the means to score a result of it.

    Parameters
    ----------
    scan : Scan
    """

    def __init__(self, scan: Scan) -> None:
        self.scan = scan
        self._good = ~scan.mixed

    @cached_property
    def surface(self) -> Surface:
        """The true mesh."""
        return Surface(self.scan.scene)

    @cached_property
    def before(self) -> Floats:
        """Distance of each point of the scan to the mesh, (N,)."""
        return self.surface.nearest(self.scan.points).distance

    def errors(self, output: Output) -> Floats:
        """Distance of each point of a result to the mesh, (M,)."""
        return self.surface.nearest(output.points).distance

    def distance(self, output: Output) -> float:
        """Mean of :meth:`errors` over points with a truth."""
        errors = self.errors(output)
        return float(errors[self._good].mean() if len(errors) == len(self._good) else errors.mean())

    def score(self, output: Output) -> ScanScore:
        """Compare a result with the truth."""
        scan, nearest = self.scan, self.surface.nearest(output.points)
        if len(output.points) != len(scan.points):
            normals = self.surface.normals[nearest.face]
            angle = float(_angles(output.normals, normals).mean())
            return ScanScore(SCALE * float(nearest.distance.mean()), None, None, None, None, angle, len(normals))
        after, good, thin = nearest.distance, self._good, self._good & scan.thin
        harmed = after > self.before + scan.sigma
        return ScanScore(
            SCALE * float(after[good].mean()),
            float((after > self.before)[good].mean()),
            float(harmed[good].mean()),
            SCALE * float(after[thin].mean()) if thin.any() else None,
            float(harmed[thin].mean()) if thin.any() else None,
            float(_angles(output.normals, scan.normals)[good].mean()),
            len(after),
        )


def simulated_scans(kinds: Sequence[str], each: int, points: int) -> list[Scan]:
    """``each`` scans of every kind, of fixed seeds.

    Raises
    ------
    PcdnfError
        ``unknown_scanner``, ``missing_extra``.
    """
    return [simulate(kind, FIRST_SEED + number, points) for kind in kinds or KINDS for number in range(each)]


def read_scans(paths: Iterable[Path]) -> list[Scan]:
    """Return scans of .npz files and folders of them.

    Raises
    ------
    PcdnfError
        ``no_clouds`` for a path without any, ``bad_scan``.
    """
    scans = []
    for path in paths:
        files = sorted(path.glob("*.npz")) if path.is_dir() else [path]
        if not files or not files[0].exists():
            raise PcdnfError(
                f"{path} holds no scan.", code="no_clouds", hint="Name .npz files with their truth, or folders of them."
            )
        scans += [load_scan(file) for file in files]
    return scans


def thinned(scan: Scan, count: int) -> Scan:
    """Return a piece of the scan at its own density: the ``count`` points nearest to the middle one."""
    if count >= len(scan.points):
        return scan
    middle = scan.points[len(scan.points) // 2]
    nearest = np.argpartition(((scan.points - middle) ** 2).sum(1), count)[:count]
    return scan.rows(np.sort(nearest))


def _angles(normals: NDArray[np.floating], true: Floats) -> Floats:
    """Degrees between directions (N, 3), up to sign."""
    given = np.asarray(normals, np.float64)
    given = given / np.maximum(np.linalg.norm(given, axis=1, keepdims=True), 1e-12)
    return np.asarray(np.degrees(np.arccos(np.clip(np.abs((given * true).sum(1)), 0, 1))))
