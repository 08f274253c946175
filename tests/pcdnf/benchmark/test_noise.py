"""Noise: its level, its kind, and that it is the same each time."""

from __future__ import annotations

import numpy as np
import pytest

from pcdnf.benchmark.noise import ANISOTROPY, KINDS, OUTLIERS, add_noise
from pcdnf.errors import PcdnfError

CLEAN = np.random.default_rng(1).uniform(size=(20_000, 3)) * [3, 4, 12]  # diagonal 13
LEVEL = 0.5


@pytest.mark.parametrize("kind", KINDS)
def test_level_is_per_cent_of_the_diagonal(kind: str) -> None:
    noisy = add_noise(CLEAN, LEVEL, kind)
    assert np.array_equal(noisy, add_noise(CLEAN, LEVEL, kind))
    step = noisy - CLEAN
    kept = np.linalg.norm(step, axis=1) < 1 if kind == "outliers" else np.ones(len(step), bool)
    assert np.sqrt(np.square(step[kept]).mean()) == pytest.approx(LEVEL / 100 * 13, rel=0.02)


def test_kinds_differ_in_their_tails() -> None:
    kurtosis = {}
    for kind in ("uniform", "gaussian", "laplace"):
        step = (add_noise(CLEAN, LEVEL, kind) - CLEAN).ravel()
        kurtosis[kind] = np.mean(step**4) / np.mean(step**2) ** 2
    assert kurtosis == pytest.approx({"uniform": 1.8, "gaussian": 3, "laplace": 6}, rel=0.05)
    spread = (add_noise(CLEAN, LEVEL, "anisotropic") - CLEAN).std(0)
    np.testing.assert_allclose(spread / spread[0], ANISOTROPY / ANISOTROPY[0], rtol=0.05)


def test_outliers_lie_anywhere_in_the_box() -> None:
    noisy = add_noise(CLEAN, 0, "outliers")
    moved = (noisy != CLEAN).any(1)
    assert moved.mean() == pytest.approx(OUTLIERS)
    assert (np.abs(noisy[moved].mean(0) - CLEAN.mean(0)) < 0.1 * np.ptp(CLEAN, axis=0)).all()


def test_no_noise_and_unknown_noise() -> None:
    assert np.array_equal(add_noise(CLEAN, 0), CLEAN)
    with pytest.raises(PcdnfError, match="'salt'") as raised:
        add_noise(CLEAN, 1, "salt")
    assert "gaussian, laplace" in (raised.value.hint or "")
