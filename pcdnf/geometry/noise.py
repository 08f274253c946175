"""Noise and spacing of a cloud, estimated from the cloud itself, and the neighbourhood that suits them.

Around a sample of points, neighbourhoods grow until they are flat: the scatter about a quadric is small against their
radius. There the scatter is the noise, and the number of points tells the spacing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from .frames import principal_axes

SAMPLE = 768
"""Points around which the scale is measured."""
SIZES = (16, 24, 36, 54, 81, 122, 182, 273, 410, 615, 922, 1384, 2076, 3114)
"""Neighbours of the growing neighbourhoods."""
FITTED = 128
"""Neighbours of one neighbourhood that the quadric is fitted to, evenly spread over the distances."""
FLAT = 0.3
"""A neighbourhood whose scatter is below this share of its radius is flat."""


@dataclass(frozen=True)
class NoiseEstimate:
    """Noise and sampling of a cloud, in its unit.

    Attributes
    ----------
    noise : float
        Standard deviation of a point's distance from the surface.
    spacing : float
        Side of the square of surface that one point stands for.
    """

    noise: float
    spacing: float

    def rounded(self) -> NoiseEstimate:
        """To three digits: what a rounding of the coordinates changes shall not change a patch."""
        return NoiseEstimate(float(f"{self.noise:.3g}"), float(f"{self.spacing:.3g}"))

    def scaled(self, factor: float) -> NoiseEstimate:
        """In another unit."""
        return NoiseEstimate(self.noise * factor, self.spacing * factor)


def normals_reach(radius: float, scale: NoiseEstimate) -> float:
    """Radius of the balls that initial normals are taken from, where patches have this ``radius``."""
    return min(radius, max(0.4 * radius, 3 * scale.noise, 2.5 * scale.spacing))


def clean_spacing(tree: cKDTree) -> float:
    """Spacing of a cloud without noise, from the 16th neighbours of a sample."""
    sample = np.linspace(0, tree.n - 1, min(tree.n, SAMPLE)).astype(np.int64)
    distance, _ = tree.query(tree.data[sample], [min(17, tree.n)])
    return float(np.median(distance)) * float(np.sqrt(np.pi / 16))


def estimate_noise(points: NDArray[np.float64], tree: cKDTree) -> NoiseEstimate:
    """Estimate noise and spacing of a cloud.

    Parameters
    ----------
    points : ndarray, (N, 3) float64
    tree : cKDTree
        Of the points.

    Returns
    -------
    NoiseEstimate
        Medians over a fixed sample of points; deterministic.
    """
    sample = np.linspace(0, len(points) - 1, min(len(points), SAMPLE)).astype(np.int64)
    noise, spacing = np.full(len(sample), np.nan), np.full(len(sample), np.nan)
    left = np.arange(len(sample))
    for size in SIZES:
        last = size == SIZES[-1] or size * 1.5 >= len(points) // 4
        size = min(size, len(points))
        distance, index = tree.query(points[sample[left]], size)
        radius = distance[:, -1]
        keep = np.unique(np.linspace(0, size - 1, min(size, FITTED)).astype(np.int64))
        scatter = _scatter(points, np.asarray(index, np.int64)[:, keep]) if size > 6 else radius
        done = ((scatter < FLAT * radius) & (radius > 0)) | last
        noise[left[done]] = (untruncated(scatter / np.maximum(radius, 1e-300)) * radius)[done]
        spacing[left[done]] = radius[done] * np.sqrt(np.pi / size)
        left = left[~done]
        if last or not len(left):
            break
    return NoiseEstimate(float(np.nanmedian(noise)), float(np.nanmedian(spacing)))


def untruncated(scatter: NDArray[np.float64]) -> NDArray[np.float64]:
    """Noise (B,) whose scatter inside a ball of radius 1 about the surface is ``scatter`` (B,): the ball cuts tails."""
    height = np.linspace(-1, 1, 201)
    noise = np.geomspace(0.01, 2, 60)
    weight = np.exp(-0.5 * (height / noise[:, None]) ** 2) * (1 - height**2)  # (60, 201)
    inside = np.sqrt((weight * height**2).sum(1) / weight.sum(1))
    return np.asarray(scatter * np.interp(scatter, inside, noise / inside))


def _scatter(points: NDArray[np.float64], index: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the standard deviation (B,) of neighbourhoods (B, K) about a quadric in their PCA frame."""
    local = points[index] - points[index[:, :1]]  # (B, K, 3)
    local = local @ principal_axes(points, index).transpose(0, 2, 1)
    size = np.maximum(np.abs(local).max((1, 2), keepdims=True), 1e-300)
    x, y, z = np.moveaxis(local / size, -1, 0)
    design = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], -1)  # (B, K, 6)
    gram = design.transpose(0, 2, 1) @ design + 1e-9 * np.eye(6)
    fit = np.linalg.solve(gram, design.transpose(0, 2, 1) @ z[..., None])
    rest = ((z - (design @ fit)[..., 0]) ** 2).sum(1) / (index.shape[1] - 6)
    return np.asarray(np.sqrt(rest) * size[:, 0, 0])
