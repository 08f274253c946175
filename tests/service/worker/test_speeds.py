from __future__ import annotations

import pytest

from service.worker.speeds import NEWEST_WEIGHT, Speeds


def test_each_model_has_an_average_of_its_own() -> None:
    speeds = Speeds()
    assert speeds.newest is None
    speeds.add("quick", 1000, 1.0)
    speeds.add("slow", 10, 1.0)
    speeds.add("quick", 2000, 1.0)
    assert speeds.of("slow") == 10
    assert speeds.of("quick") == speeds.newest == pytest.approx(1000 + NEWEST_WEIGHT * 1000)
    assert speeds.of("another") is None
