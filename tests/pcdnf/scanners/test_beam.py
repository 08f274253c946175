from dataclasses import replace

import numpy as np
import pytest

from pcdnf.scanners.beam import Beam, Echoes, measure
from pcdnf.scanners.scene import Mesh, SceneBuilder
from pcdnf.scanners.solids import box
from pcdnf.scanners.surface import Surface

BEAM = Beam(noise=1e-3, doubling=20.0, waist=2e-3, divergence=1.5e-4, merging=0.6, pointing=0.0)


def surface(*pieces: Mesh) -> Surface:
    builder = SceneBuilder()
    builder.add("wall", *pieces)
    return Surface(builder.build())


def shoot(surface: Surface, beam: Beam, directions: np.ndarray) -> Echoes:
    directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    rng = np.random.default_rng(0)
    return measure(rng, surface, beam, np.zeros(directions.shape), directions, np.ones(1))


def test_noise_grows_with_range_and_incidence_as_it_is_told() -> None:
    sigmas = {}
    for distance, slope in ((5.0, 0.0), (40.0, 0.0), (5.0, 3.0)):
        # a wall through (distance, 0, 0) that leans by the slope
        across = np.array([[distance - slope * 30, -30], [distance + slope * 30, 30]])

        wall = np.array([[*across[0], -9.0], [*across[1], -9.0], [*across[1], 9.0], [*across[0], 9.0]])

        directions = np.tile([1.0, 0.0, 1e-3], (4000, 1))
        echoes = shoot(surface((wall, np.array([[0, 1, 2], [0, 2, 3]]))), BEAM, directions)
        residual = echoes.measured - echoes.ideal
        assert residual.std() == pytest.approx(echoes.sigma.mean(), rel=0.05)
        assert echoes.ideal.mean() == pytest.approx(distance, rel=1e-3)
        sigmas[distance, slope] = echoes.sigma.mean()
    assert sigmas[5.0, 0.0] == pytest.approx(1e-3 * np.hypot(1, 5 / 20), rel=1e-3)
    assert sigmas[40.0, 0.0] == pytest.approx(1e-3 * np.hypot(1, 2), rel=1e-3)
    assert sigmas[5.0, 3.0] == pytest.approx(sigmas[5.0, 0.0] * np.sqrt(10), rel=0.02)


def test_at_an_edge_echoes_merge_within_a_pulse_and_part_beyond_it() -> None:
    fan = np.stack([np.ones(2001), np.linspace(-1e-3, 1e-3, 2001), np.full(2001, 1e-4)], 1)
    for gap, merged in ((0.3, True), (3.0, False)):
        walls = surface(box([10, -9, -9], [10.01, 0, 9]), box([10 + gap, -9, -9], [10.01 + gap, 9, 9]))
        ideal = shoot(walls, BEAM, fan).ideal
        between = (ideal > 10.01) & (ideal < 10 + gap - 0.01)
        assert between.any() == merged
        assert between.mean() < 0.4


def test_nothing_comes_back_from_nowhere_or_from_beyond_the_range() -> None:
    wall = surface(box([10, -9, -9], [10.1, 9, 9]))
    directions = np.array([[1.0, 0, 0], [-1.0, 0, 0]])
    assert shoot(wall, BEAM, directions).ray.tolist() == [0]
    assert len(shoot(wall, replace(BEAM, longest=9.0), directions).ray) == 0
