"""Runs: what is computed, what is found again, and what survives a kill."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from pcdnf.benchmark.clouds import CleanCloud, analytic_clouds
from pcdnf.benchmark.methods import Group, Noisy, Output, our_methods
from pcdnf.benchmark.runs import Case, Results, Row, cases
from pcdnf.errors import PcdnfError
from pcdnf.metrics import score


@dataclass
class Shift:
    """A method that moves all points by a vector and counts its runs."""

    step: float
    name: str = "shift"
    group: Group = "peer"
    runs: list[float] = field(default_factory=list)

    @property
    def identity(self) -> dict[str, str]:
        return {"method": "shift", "step": str(self.step)}

    def run(self, points: NDArray[np.float64], level: float) -> Output:
        self.runs.append(level)
        return Output(
            points + np.array([self.step, 0, 0]), np.tile(np.float32([1, 0, 0]), (len(points), 1)), {"said": "yes"}
        )


@pytest.fixture
def cloud() -> CleanCloud:
    return analytic_clouds(500)[0]


def test_a_row_is_the_score_of_what_came_out(tmp_path: Path, cloud: CleanCloud) -> None:
    case, method = Case(cloud, "gaussian", 1.0), Shift(0.01)
    results = Results(tmp_path)
    (row,) = results.run(case, [method])
    scores = score(case.points() + np.array([0.01, 0, 0]), np.tile([1, 0, 0], (500, 1)), cloud.points, cloud.normals)
    assert row.point_to_surface == scores.point_to_surface
    assert (row.chamfer_distance, row.normal_mean) == (scores.chamfer_distance, scores.normal_mean)
    assert (row.cloud, row.level, row.group, row.facts) == ("block", 1.0, "peer", {"said": "yes"})
    output = results.output(row, cloud)
    np.testing.assert_allclose(output.points, case.points() + np.array([0.01, 0, 0]), atol=1e-6)


def test_what_is_there_is_not_computed_again(tmp_path: Path, cloud: CleanCloud) -> None:
    method, case = Shift(0.01), Case(cloud, "gaussian", 1.0)
    seen: list[bool] = []

    def report(_: Row, new: bool) -> None:
        seen.append(new)

    first = Results(tmp_path).run(case, [method], report=report)
    assert Results(tmp_path).run(case, [method], report=report) == first
    Results(tmp_path).run(case, [Shift(0.02)], report=report)  # another method
    Results(tmp_path).run(Case(cloud, "gaussian", 2.0), [method], report=report)  # another input
    Results(tmp_path, fresh=True).run(case, [method], report=report)
    assert seen == [True, False, True, True, True]
    assert method.runs == [1.0, 2.0, 1.0]


def test_half_a_line_and_a_missing_cloud_are_made_good(tmp_path: Path, cloud: CleanCloud) -> None:
    method, case = Shift(0.01), Case(cloud, "gaussian", 1.0)
    (row,) = Results(tmp_path).run(case, [method])
    lines = tmp_path / "results.jsonl"
    lines.write_text(lines.read_text() + '{"key": "torn')
    (tmp_path / "clouds" / f"{row.key}.npz").unlink()
    Results(tmp_path).run(case, [method])
    assert len(method.runs) == 2
    assert [json.loads(line)["key"] for line in lines.read_text().splitlines()] == [row.key, row.key]
    Results(tmp_path).run(case, [method])
    assert len(method.runs) == 2


def test_without_noise_there_is_one_case(cloud: CleanCloud) -> None:
    found = [(case.noise, case.level) for case in cases([cloud], ["gaussian", "laplace"], [0, 1])]
    assert found == [("gaussian", 0), ("gaussian", 1), ("laplace", 1)]


def test_our_models_denoise_and_are_known_by_their_weights(tmp_path: Path, cloud: CleanCloud) -> None:
    methods = our_methods(["pcdnf-lite"], [1, 2], device="cpu")
    assert [method.name for method in methods] == ["pcdnf-lite x 1", "pcdnf-lite x 2"]
    assert len(methods[0].identity["weights_sha256"]) == 64
    noisy, once, twice = Results(tmp_path).run(Case(cloud, "gaussian", 2.0), [Noisy(), *methods])
    assert once.point_to_surface < noisy.point_to_surface
    assert twice.facts["iterations"] == "2"
    with pytest.raises(PcdnfError, match="twice"):
        our_methods(["pcdnf-lite", "pcdnf-lite"], [1])
