"""Peers with their best parameter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from pcdnf.benchmark.choice import Choice, run_timed
from pcdnf.benchmark.methods import Group, Noisy, Output
from pcdnf.errors import PcdnfError

POINTS = np.random.default_rng(0).normal(size=(40, 3))


@dataclass(frozen=True)
class Shift:
    """A method that moves all points along x; a negative step fails."""

    step: float
    group: Group = "peer"

    @property
    def name(self) -> str:
        return f"step {self.step:g}"

    @property
    def identity(self) -> dict[str, str]:
        return {"method": "shift", "step": str(self.step)}

    def run(self, points: NDArray[np.float64], level: float) -> Output:
        if self.step < 0:
            raise PcdnfError("It failed.", code="peer_failed", hint="None.")
        return Output(points + np.array([self.step, 0, level]), np.ones(points.shape))


def away(output: Output) -> float:
    """From a shift of 2."""
    return float(np.abs(output.points[0, 0] - POINTS[0, 0] - 2))


def test_the_candidate_of_least_error_is_taken_and_named() -> None:
    output, seconds = Choice("shift, best step", (Shift(0.5), Shift(2.5), Shift(9.0))).run(POINTS, 0.0, away)
    assert np.allclose(output.points, POINTS + np.array([2.5, 0, 0]))
    assert output.facts == {"chosen": "step 2.5", "of": 3}
    assert 0 <= seconds < 5


def test_a_candidate_that_fails_is_passed_over() -> None:
    output, _ = Choice("shift", (Shift(-1.0), Shift(1.0))).run(POINTS, 0.0, away)
    assert output.facts["chosen"] == "step 1"
    with pytest.raises(PcdnfError, match="It failed"):
        Choice("shift", (Shift(-1.0),)).run(POINTS, 0.0, away)


def test_another_grid_is_another_identity() -> None:
    assert Choice("shift", (Shift(1.0),)).identity != Choice("shift", (Shift(1.0), Shift(2.0))).identity


def test_a_method_without_a_choice_is_timed_alike() -> None:
    output, seconds = run_timed(Noisy(), POINTS, 0.0, away)
    assert output.points is POINTS
    assert seconds >= 0
