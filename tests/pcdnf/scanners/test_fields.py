import numpy as np
import pytest

from pcdnf.scanners.fields import SmoothField


def test_values_have_variance_one_and_are_alike_nearby_alone() -> None:
    rng = np.random.default_rng(0)
    at = rng.uniform(-50, 50, (400, 3))
    fields = [SmoothField(rng, 2.0) for _ in range(40)]

    def correlation(distance: float) -> float:
        there = at + distance * np.array([1.0, 0, 0])
        return float(np.mean([np.mean(field(at) * field(there)) for field in fields]))

    assert correlation(0.0) == pytest.approx(1, abs=0.05)
    assert correlation(2.0) == pytest.approx(np.exp(-0.5), abs=0.05)
    assert correlation(8.0) == pytest.approx(0, abs=0.05)
