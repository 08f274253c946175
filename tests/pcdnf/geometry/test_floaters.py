"""Floaters beside a noisy surface, and what must not be taken for one."""

from __future__ import annotations

import numpy as np

from pcdnf.geometry.floaters import floaters

RNG = np.random.default_rng(3)
SPACING, NOISE = 0.1, 0.03


def sheet(count: int = 9000) -> np.ndarray:
    """A wavy sheet of even density, seen from nowhere in particular."""
    side = SPACING * np.sqrt(count)
    x, y = np.random.default_rng(1).uniform(0, side, (2, count))
    return np.column_stack([x, y, 0.3 * np.sin(x) + np.random.default_rng(2).normal(0, NOISE, count)])


def test_small_clusters_beside_the_surface_are_found() -> None:
    cloud = sheet()
    cluster = np.array([4.0, 4.0, 1.0]) + RNG.normal(0, 0.08, (40, 3))
    found = floaters(np.concatenate([cloud, cluster]))
    assert found[-40:].mean() > 0.8
    assert found[:-40].mean() < 0.002


def test_single_points_off_the_surface_are_found() -> None:
    cloud = sheet()
    rows = RNG.choice(len(cloud), 60, replace=False)
    cloud[rows, 2] += RNG.choice([-1, 1], 60) * RNG.uniform(5, 9, 60) * SPACING
    found = floaters(cloud)
    assert found[rows].mean() > 0.8
    assert np.delete(found, rows).mean() < 0.002


def test_a_second_object_stays() -> None:
    cloud = np.concatenate([sheet(), sheet(1200) * [1, 1, 0.2] + [2, 2, 3]])
    assert floaters(cloud).mean() < 0.002


def test_a_wire_stays() -> None:
    wire = np.column_stack([np.linspace(0, 8, 80), np.full(80, 5.0), np.full(80, 2.0)])
    found = floaters(np.concatenate([sheet(), wire + RNG.normal(0, 0.003, wire.shape)]))
    assert not found[-80:].any()


def test_uneven_or_unresolved_sampling_is_not_judged() -> None:
    cloud = sheet(12000)
    cluster = np.array([4.0, 4.0, 1.0]) + RNG.normal(0, 0.08, (40, 3))
    thinned = cloud[RNG.random(len(cloud)) < np.where(cloud[:, 0] > 4, 0.1, 1)]
    assert not floaters(np.concatenate([thinned, cluster])).any()
    smooth = cloud * [1, 1, 0]
    assert not floaters(np.concatenate([smooth, cluster])).any()
    assert not floaters(cloud[:500]).any()
