"""Kinds of noise, each a function of the clean cloud and a level, from one fixed generator."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from ..errors import PcdnfError

Floats = NDArray[np.float64]

OUTLIERS = 0.02
"""Share of points that ``outliers`` throws anywhere into the bounding box, grown by a tenth."""
ANISOTROPY = np.array([0.4, 0.8, 1.5]) / np.sqrt(np.mean(np.square([0.4, 0.8, 1.5])))
"""Level of each axis, of mean square 1."""


def _unit_laplace(rng: Generator, shape: tuple[int, ...]) -> Floats:
    return rng.laplace(scale=np.sqrt(0.5), size=shape)


def _unit_uniform(rng: Generator, shape: tuple[int, ...]) -> Floats:
    return rng.uniform(-np.sqrt(3), np.sqrt(3), size=shape)


def _unit_anisotropic(rng: Generator, shape: tuple[int, ...]) -> Floats:
    noise: Floats = rng.normal(size=shape) * ANISOTROPY
    return noise


def _unit_gaussian(rng: Generator, shape: tuple[int, ...]) -> Floats:
    return rng.normal(size=shape)


_UNIT: dict[str, Callable[[Generator, tuple[int, ...]], Floats]] = {
    "gaussian": _unit_gaussian,
    "laplace": _unit_laplace,
    "uniform": _unit_uniform,
    "anisotropic": _unit_anisotropic,
    "outliers": _unit_gaussian,
}
KINDS = tuple(_UNIT)


def add_noise(clean: Floats, level: float, kind: str = "gaussian") -> Floats:
    """Add noise to a cloud, the same on every call.

    Parameters
    ----------
    clean : (N, 3) float64 array
    level : float
        Standard deviation of a coordinate in per cent of the clean cloud's bounding-box diagonal (of the three
        together, for ``anisotropic``).
    kind : str
        One of ``KINDS``; ``outliers`` is Gaussian noise, and one point in fifty lies anywhere in the box.

    Raises
    ------
    PcdnfError
        ``unknown_noise``.
    """
    check_kind(kind)
    rng = np.random.default_rng(0)
    extent = np.ptp(clean, axis=0)
    noisy = clean + _UNIT[kind](rng, clean.shape) * level / 100 * float(np.linalg.norm(extent))
    if kind == "outliers":
        thrown = rng.choice(len(clean), int(OUTLIERS * len(clean)), replace=False)
        low, high = clean.min(axis=0) - 0.05 * extent, clean.max(axis=0) + 0.05 * extent
        noisy[thrown] = rng.uniform(low, high, (len(thrown), 3))
    return np.asarray(noisy, np.float64)


def check_kind(kind: str) -> None:
    """Raise ``unknown_noise`` for anything but one of ``KINDS``."""
    if kind not in _UNIT:
        raise PcdnfError(
            f"There is no noise named {kind!r}.", code="unknown_noise", hint=f"Use one of {', '.join(KINDS)}."
        )
