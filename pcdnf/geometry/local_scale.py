"""Noise, spacing and extent around each point of a cloud, from the points near it alone.

Quadrics are fitted around every sixteenth point along a space-filling curve, at sizes from 12 to 200 neighbours. The
scatter about them, as a curve over the size, tells noise from shape:

* white noise has the same scatter at every size;
* correlated noise, and noise deeper than a small neighbourhood, has a scatter that grows ever more slowly;
* shape that a quadric does not follow has a scatter that grows ever faster.

So the noise is the scatter at the largest size up to which growth does not speed up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from .noise import NoiseEstimate, untruncated
from .quadric_scales import fit_scales

SIZES = (12, 18, 27, 40, 60, 90, 135, 200)
"""Neighbours of the fits around a sample."""
LARGE_SIZES = (300, 450, 675, 1000, 1500, 2250, 3400)
"""Neighbours where even the largest of ``SIZES`` is no deeper than the noise."""
FITTED = 200
"""Neighbours that a fit takes at most."""
STEP, FEWEST_SAMPLES = 16, 768
"""Every how manyth point is a sample, and how many there are at least, of a small cloud."""
AROUND = 24
"""Samples whose curves are taken together."""
SHARE, UPWARDS = 0.42, 1.06
"""Quantile of their scatters, a little below the median against edges, and what makes up for it on a plain."""
FINE = 0.2
"""Noise in spacings below which growing scatter is always taken for shape."""
FLAT, DEEP = 0.37, 0.22
"""Scatter as a share of the radius below which a neighbourhood is flat, and above which larger ones are tried. Points
that fill a ball have 0.447; larger neighbourhoods than needed take curvature for noise."""
TWO_PEAKS, ENOUGH_FOR_PEAKS = 1.95, 27
"""Kurtosis of heights below which they have two peaks (uniform ones have 1.8), and neighbours that it takes to tell."""
MOST_ALIKE = 1.6
"""Growth of the noise beyond which it is not taken for noise that is alike."""
SMOOTH = 8
"""Samples over whose logarithms the estimates are averaged."""
GAP = 6.0
"""Distance of samples, in what is usual around them, beyond which they belong to different objects."""
GRADES = 64
"""Steps an octave that estimates are rounded to: a rounding of coordinates shall not change them."""


@dataclass(frozen=True)
class LocalScale:
    """Noise and sampling around each point, in the unit of the points.

    Attributes
    ----------
    noise : ndarray, (N,) float64
        Standard deviation of the points' distance from the surface.
    spacing : ndarray, (N,) float64
        Side of the square of surface that one point stands for.
    double : ndarray, (N,) bool
        Where the points lie on two sheets so near to one another that no neighbourhood holds one alone; ``noise`` is
        that of one sheet.
    alike : ndarray, (N,) float64
        How much the noise of neighbours is alike, from 1 on. It still grows by so much from the middle one of the
        sizes on, and a mean over as many points removes less of it.
    extent : ndarray, (N,) float64
        Diagonal of the object that the point belongs to: points that gaps separate from it do not count.
    """

    noise: NDArray[np.float64]
    spacing: NDArray[np.float64]
    double: NDArray[np.bool_]
    alike: NDArray[np.float64]
    extent: NDArray[np.float64]

    @property
    def ratio(self) -> NDArray[np.float64]:
        """Noise in spacings, (N,)."""
        return np.asarray(self.noise / np.maximum(self.spacing, 1e-300))

    def median(self) -> NoiseEstimate:
        """One noise and one spacing that are typical."""
        return NoiseEstimate(float(np.median(self.noise)), float(np.median(self.spacing)))


def estimate_local_scale(points: NDArray[np.float64], tree: cKDTree, order: NDArray[np.int64]) -> LocalScale:
    """Estimate noise, spacing and extent around each point.

    Parameters
    ----------
    points : ndarray, (N, 3) float64
        Distinct, at least 8.
    tree : cKDTree
        Of the points.
    order : ndarray, (N,) int64
        The points along a space-filling curve.

    Returns
    -------
    LocalScale
        Deterministic; smooth over the cloud but for the rounding of its logarithms.
    """
    step = max(1, min(STEP, len(points) // FEWEST_SAMPLES))
    rows = order[step // 2 :: step]
    samples = cKDTree(points[rows])
    around = samples.query(points[rows], min(AROUND, len(rows)), workers=-1)[1].reshape(len(rows), -1)
    sizes = np.array([size for size in SIZES if size <= max(len(points) // 4, SIZES[0])])
    sizes = np.minimum(sizes, len(points))
    curves = _curves(points, rows, sizes, tree, around)
    at = _plateau(curves, sizes)
    noise, spacing = curves.scale(at)
    double = curves.double(at)
    noise = np.where(double, curves.of_one_sheet(at), noise)
    alike = curves.growth(at)
    last = (curves.scatter[:, -1] > DEEP * curves.radius[:, -1]) & (at == len(sizes) - 1)
    deep = last & ~double & (len(points) // 4 >= LARGE_SIZES[0])
    if deep.any():
        alike[deep] = 1  # it grows because the smaller balls cut off the noise
        noise[deep], spacing[deep] = _deep_scale(points, rows, np.flatnonzero(deep), tree)
    extent = _extents(points[rows], samples)
    smooth = around[:, :SMOOTH]
    noise, spacing, alike = (
        np.exp(np.log(np.maximum(each, 1e-300))[smooth].mean(1)) for each in (noise, spacing, alike)
    )
    return _at_points(points, samples, noise, spacing, double, alike, extent)


@dataclass(frozen=True)
class _Curves:
    """Scatter, radius and kurtosis (B, S) at S sizes, typical of the fits around B samples."""

    sizes: NDArray[np.int64]
    scatter: NDArray[np.float64]
    radius: NDArray[np.float64]
    kurtosis: NDArray[np.float64]

    def scale(self, at: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Noise and spacing (B,) by the size of index ``at`` (B,)."""
        every = np.arange(len(at))
        scatter, radius = self.scatter[every, at], self.radius[every, at]
        noise = untruncated(scatter / np.maximum(radius, 1e-300)) * radius
        return noise, radius * np.sqrt(np.pi / self.sizes[at])

    def growth(self, at: NDArray[np.int64]) -> NDArray[np.float64]:
        """How much (B,) the noise grows from the middle size to the largest, 1 where ``at`` (B,) is not the largest."""
        largest = np.full(len(at), len(self.sizes) - 1)
        grown = self.scale(largest)[0] / np.maximum(self.scale(largest // 2)[0], 1e-300)
        return np.where(at == largest, np.clip(grown, 1, MOST_ALIKE), 1.0)

    def double(self, at: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Where (B,) the heights have two peaks at the size of index ``at`` (B,)."""
        flat = self.kurtosis[np.arange(len(at)), at] < TWO_PEAKS
        return np.asarray(flat & (self.sizes[at] >= ENOUGH_FOR_PEAKS))

    def of_one_sheet(self, at: NDArray[np.int64]) -> NDArray[np.float64]:
        """Noise (B,) of one of two sheets: its share x of the variance makes the kurtosis 1 + 4 x - 2 x^2."""
        every = np.arange(len(at))
        share = 1 - np.sqrt(np.clip(3 - self.kurtosis[every, at], 0, 2) / 2)
        return np.asarray(self.scatter[every, at] / UPWARDS * np.sqrt(share))


def _curves(
    points: NDArray[np.float64],
    rows: NDArray[np.int64],
    sizes: NDArray[np.int64],
    tree: cKDTree,
    around: NDArray[np.int64],
) -> _Curves:
    """Curves (B, S) over the sizes, each typical of the samples ``around`` (B, A) one."""
    fits = fit_scales(points, rows, sizes, tree=tree, most=FITTED)
    last = around.shape[1] - 1

    def typical(values: NDArray[np.float64], share: float) -> NDArray[np.float64]:
        filled = np.where(np.isfinite(values), values, np.inf)
        chosen = np.partition(filled[around], round(share * last), axis=1)[:, round(share * last)]
        return np.where(np.isfinite(chosen), chosen, 1e-300)

    scatter = UPWARDS * typical(fits.scatter, SHARE)
    return _Curves(sizes, scatter, typical(fits.radius, 0.5), typical(fits.kurtosis, 0.5))


def _plateau(curves: _Curves, sizes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Index (B,) of the largest size up to which the scatter does not grow faster than it began to."""
    scatter, radius = curves.scatter, curves.radius
    height, size = np.log(np.maximum(scatter, 1e-4 * radius)), np.log(sizes)
    second = min(1, len(sizes) - 1)
    ratio = scatter[:, second] / (radius[:, second] * np.sqrt(np.pi / sizes[second]))
    coarse = ratio > FINE
    best = np.full(len(scatter), second)
    best[~coarse & (scatter[:, second] > 1.25 * scatter[:, 0])] = 0
    for last in range(2, len(sizes)):
        half = (last + 1) // 2
        first = (height[:, half] - height[:, 0]) / (size[half] - size[0])
        then = (height[:, last] - height[:, half]) / (size[last] - size[half])
        now = (height[:, last] - height[:, last - 1]) / (size[last] - size[last - 1])
        allowed = 0.8 * np.clip(first, 0, 0.8)
        slowing = (then < allowed + 0.04) & (now < allowed + 0.08)
        best[slowing & (coarse | ((then < 0.08) & (first < 0.12)))] = last
    return best


def _deep_scale(
    points: NDArray[np.float64], rows: NDArray[np.int64], deep: NDArray[np.int64], tree: cKDTree
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Noise and spacing (D,) of the samples ``deep`` (D,) of ``rows``, measured around an eighth of them."""
    few = rows[deep[len(deep) % 8 // 2 :: 8]]
    sizes = np.array([size for size in (SIZES[-1], *LARGE_SIZES) if size <= len(points) // 4])
    chosen = cKDTree(points[few])
    around = chosen.query(points[few], min(AROUND, len(few)), workers=-1)[1].reshape(len(few), -1)
    curves = _curves(points, few, sizes, tree, around)
    flat = curves.scatter < FLAT * curves.radius
    noise, spacing = curves.scale(np.where(flat.any(1), flat.argmax(1), len(sizes) - 1))
    nearest = chosen.query(points[rows[deep]], workers=-1)[1]
    return noise[nearest], spacing[nearest]


def _extents(places: NDArray[np.float64], samples: cKDTree) -> NDArray[np.float64]:
    """Diagonal (B,) of the object that each sample at ``places`` (B, 3) belongs to, without its outermost points."""
    distance, index = samples.query(places, min(7, len(places)), workers=-1)
    if len(places) < 2:
        return np.full(len(places), 1e-300)
    usual = np.median(distance[:, 1:], axis=1)
    around = np.median(usual[index[:, 1:]], axis=1)
    near = distance[:, 1:] <= GAP * np.minimum(around[:, None], around[index[:, 1:]])  # by the measure of both ends
    row, column = np.nonzero(near)
    graph = coo_matrix((np.ones(len(row), np.int8), (row, index[row, column + 1])), (len(places),) * 2)
    count, label = connected_components(graph, directed=False)
    extent = np.empty(len(places))
    order = np.argsort(label, kind="stable")
    for part in np.split(order, np.cumsum(np.bincount(label, minlength=count))[:-1]):
        low, high = np.quantile(places[part], (0.005, 0.995), axis=0)
        extent[part] = np.linalg.norm(high - low)
    return extent


def _at_points(
    points: NDArray[np.float64],
    samples: cKDTree,
    noise: NDArray[np.float64],
    spacing: NDArray[np.float64],
    double: NDArray[np.bool_],
    alike: NDArray[np.float64],
    extent: NDArray[np.float64],
) -> LocalScale:
    """Interpolate the samples' logarithms to the points, weighted by nearness."""
    count = min(4, samples.n)
    distance, index = samples.query(points, count, workers=-1)
    distance, index = distance.reshape(-1, count), index.reshape(-1, count)
    weight = (distance + 0.1 * distance[:, -1:] + 1e-300) ** -2
    weight /= weight.sum(1, keepdims=True)

    def spread(values: NDArray[np.float64]) -> NDArray[np.float64]:
        octave = (np.log2(np.maximum(values, 1e-300))[index] * weight).sum(1)
        return np.asarray(np.exp2(np.round(octave * GRADES) / GRADES))

    doubled = (double[index] * weight).sum(1) > 0.5
    return LocalScale(spread(noise), spread(spacing), doubled, spread(alike), extent[index[:, 0]])
