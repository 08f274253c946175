from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.stats import kurtosis

from pcdnf.training.corruption import Corruption

CLEAN = np.random.default_rng(0).uniform(-0.5, 0.5, (20_000, 3))
PLAIN = Corruption(**{field.name: 0.0 for field in fields(Corruption) if field.name not in ("points", "thin")})


def test_the_usual_mix_has_many_kinds() -> None:
    levels, tails, sizes = [], [], []
    for seed in range(60):
        noise, level = Corruption().noise(np.random.default_rng(seed), CLEAN)
        levels.append(level)
        tails.append(float(np.abs(noise).max() / level))
        sizes.append(len(Corruption().kept(np.random.default_rng(seed), CLEAN)))
    assert 0 <= min(levels) < 0.002
    assert 0.02 < max(levels) <= 0.03
    assert min(tails) < 3 < 10 < max(tails)  # uniform noise, and outliers
    assert min(sizes) < 0.9 * max(sizes) == 0.9 * len(CLEAN)


@pytest.mark.parametrize(("kind", "tail"), [("gaussian", 0.0), ("laplace", 3.0), ("uniform", -1.2)])
def test_each_noise_has_its_tail(kind: str, tail: float) -> None:
    corruption = PLAIN if kind == "gaussian" else replace(PLAIN, **{kind: 1.0})
    noise, level = corruption.noise(np.random.default_rng(1), CLEAN)
    assert noise.std() == pytest.approx(level, rel=0.02)
    assert kurtosis(noise.ravel()) == pytest.approx(tail, abs=0.3)


def test_a_scanner_errs_along_its_ray_and_anisotropic_noise_by_axis() -> None:
    noise, _ = replace(PLAIN, scanner=1.0).noise(np.random.default_rng(2), CLEAN)
    spread = np.linalg.svd(noise, compute_uv=False)
    assert spread[0] > 2 * spread[2]
    noise, _ = replace(PLAIN, anisotropic=1.0).noise(np.random.default_rng(2), CLEAN)
    assert noise.std(0).max() > 1.3 * noise.std(0).min()


def test_what_is_missing_and_how_many_there_are() -> None:
    rng = np.random.default_rng(3)
    assert len(PLAIN.kept(rng, CLEAN)) == len(CLEAN)
    for name in ("uneven", "holes"):
        assert 2000 < len(replace(PLAIN, **{name: 1.0}).kept(rng, CLEAN)) < len(CLEAN)
    counts = [replace(PLAIN, points=(1000, 3000)).count(rng) for _ in range(50)]
    assert 1000 <= min(counts) < 1300 < 2500 < max(counts) <= 3000
    assert 6000 <= min(Corruption().count(rng) for _ in range(200)) < 50_000
