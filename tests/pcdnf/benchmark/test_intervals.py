"""Intervals: they hold the truth as often as they say, also where neighbours' errors hang together."""

from __future__ import annotations

import numpy as np
import pytest

from pcdnf.benchmark.intervals import paired_interval

PLACES = np.random.default_rng(0).uniform(size=(4000, 3)) * [1, 1, 0]


def test_mean_and_determinism() -> None:
    first, second = np.arange(4000.0), np.zeros(4000)
    interval = paired_interval(first, second, PLACES)
    assert interval.mean == pytest.approx(1999.5)
    assert interval.low < interval.mean < interval.high
    assert interval == paired_interval(first, second, PLACES)
    assert interval != paired_interval(first, second, PLACES, seed=1)


def test_equal_methods_differ_by_nothing() -> None:
    interval = paired_interval(PLACES[:, 0], PLACES[:, 0], PLACES)
    assert (interval.mean, interval.low, interval.high) == (0, 0, 0)


def test_neighbours_that_err_together_widen_the_interval() -> None:
    rng = np.random.default_rng(1)
    _, patch = np.unique(np.floor(PLACES * 10), axis=0, return_inverse=True)
    alone, together = rng.normal(size=4000), rng.normal(size=patch.max() + 1)[patch.ravel()]
    widths = []
    for errors in (alone, together):
        interval = paired_interval(errors, np.zeros(4000), PLACES)
        widths.append(interval.high - interval.low)
    assert widths[0] == pytest.approx(2 * 1.96 / np.sqrt(4000), rel=0.15)
    assert widths[1] > 3 * widths[0]
