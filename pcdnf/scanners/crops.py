"""Small pieces of scans with their true noise and spacing: what a training takes its patches from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from scipy.spatial import cKDTree

from .scan import Scan
from .scene import Bools, Floats, Ints

AROUND = 64
"""Points about the middle of a crop that noise and spacing are taken from."""
INNER, MARGIN = 4.0, 2.6
"""Of a crop, in patch radii: patches have their centres within ``INNER``, and points reach ``MARGIN`` further."""
LARGEST = 40_000
"""Points of a crop; the outer ones are left out where there are more."""
FEWEST = 24
"""Centres of a crop: one that has fewer is not worth its time."""


@dataclass(frozen=True)
class Crop:
    """A piece of a scan, in patch radii about its middle.

    Attributes
    ----------
    points, clean, normals : ndarray, (N, 3) float64
        As in :class:`Scan`.
    centres : ndarray, (C,) int64
        Rows whose patches are whole and whose truth is known.
    true : ndarray, (N,) bool
        Rows that are not mixed.
    noise, spacing : float
        True ones in the middle: of the distances from the surface, and the side of the square that a point stands for.
    """

    points: Floats
    clean: Floats
    normals: Floats
    centres: Ints
    true: Bools
    noise: float
    spacing: float


class Cropper:
    """Takes crops from one scan.

    Parameters
    ----------
    scan : Scan
    factor : float
        Patch radius over the geometric mean of noise and spacing.
    """

    def __init__(self, scan: Scan, factor: float) -> None:
        self._scan, self._factor = scan, factor
        self._true = np.flatnonzero(~scan.mixed)
        self._clean_tree, self._tree = cKDTree(scan.clean[self._true]), cKDTree(scan.points)
        self._thin = self._true[scan.thin[self._true]]
        self._error = ((scan.points - scan.clean) * scan.normals).sum(1)

    def crop(self, rng: Generator, fewest: int) -> Crop | None:
        """Return a random crop, a quarter of them about thin parts; None where the scan is too sparse for one.

        ``fewest`` is the number of points that a flat patch holds at least.
        """
        scan = self._scan
        chosen = self._thin if len(self._thin) > AROUND and rng.random() < 0.25 else self._true
        middle = int(chosen[rng.integers(len(chosen))])
        distance, near = self._clean_tree.query(scan.clean[middle], AROUND)
        spacing = float(np.median(self._clean_tree.query(scan.clean[self._true[near]], [17])[0]) * np.sqrt(np.pi / 16))
        noise = float(np.sqrt(np.mean(self._error[self._true[near]] ** 2)))
        radius = max(self._factor * np.sqrt(noise * spacing), spacing * np.sqrt(fewest / np.pi))
        if not spacing > 0 or distance[-1] > INNER * radius:
            return None
        at = scan.points[middle]
        rows = np.array(self._tree.query_ball_point(at, (INNER + MARGIN) * radius), np.int64)
        reach = np.linalg.norm(scan.points[rows] - at, axis=1)
        nearest = np.argsort(reach, kind="stable")[:LARGEST]
        inner = INNER * radius if len(nearest) == len(rows) else reach[nearest[-1]] - MARGIN * radius
        rows = np.sort(rows[nearest])
        true = ~scan.mixed[rows]
        centres = np.flatnonzero(true & (np.linalg.norm(scan.points[rows] - at, axis=1) < inner))
        if len(centres) < FEWEST:
            return None
        return Crop(
            (scan.points[rows] - at) / radius,
            (scan.clean[rows] - at) / radius,
            scan.normals[rows],
            centres,
            true,
            noise / radius,
            spacing / radius,
        )
