"""What the parameters of a job do, over HTTP."""

from __future__ import annotations

from pathlib import Path

import httpx
import numpy as np
import pytest

from pcdnf.formats import PointCloud, read, write
from tests.support.clouds import depth_image
from tests.support.service_process import Service, sphere


def _result(running: Service, path: Path, **parameters: str) -> tuple[dict[str, object], PointCloud]:
    job = running.wait_status(running.submit(path, **parameters)["id"], "succeeded", "failed")
    assert job["status"] == "succeeded", job["problem"]
    response: httpx.Response = running.client.get(f"/jobs/{job['id']}/result")
    (path.parent / "result").write_bytes(response.content)
    return job, read(path.parent / "result")


@pytest.fixture
def ball(tmp_path: Path) -> Path:
    points = sphere(3000)
    points[[7, 1200]] = [[9, 9, 9], [-8, 9, 9]]
    path = tmp_path / "ball.ply"
    write(path, PointCloud(points=points, normals=-points / np.linalg.norm(points, axis=1, keepdims=True)))
    return path


def test_what_was_chosen_is_told(running: Service, ball: Path) -> None:
    job, result = _result(running, ball, iterations="auto")
    plan = job["execution"]["plan"]  # type: ignore[index]
    assert job["parameters"]["iterations"] == job["parameters"]["radius"] == "auto"  # type: ignore[index]
    assert job["progress"]["total"] == 3000 * len(plan["radii"])  # type: ignore[index]
    assert int(result.metadata["iterations"]) == len(plan["radii"])
    assert float(result.metadata["estimated_noise"]) == pytest.approx(plan["noise"], rel=1e-3)
    assert 0.02 < plan["spacing"] < 0.2


def test_iterations_and_a_radius_of_the_callers(running: Service, ball: Path) -> None:
    job, result = _result(running, ball, iterations="3", radius="0.4")
    assert job["execution"]["plan"]["radii"] == pytest.approx([0.4, 0.4, 0.4])  # type: ignore[index]
    assert result.metadata["radius"] == "0.4, 0.4, 0.4"


def test_outliers_go_and_their_rows_are_named(running: Service, ball: Path) -> None:
    job, result = _result(running, ball, outliers="drop", orient="true")
    assert len(result) == 2998
    assert result.metadata["dropped_rows"].startswith("7, 1200")
    assert any("Outliers were left out: 7, 1200" in str(warning) for warning in job["warnings"])  # type: ignore[union-attr]
    assert job["progress"] == {"done": job["progress"]["total"], "total": job["progress"]["total"], "unit": "points"}  # type: ignore[index]


def test_outliers_are_marked_and_stay(running: Service, ball: Path) -> None:
    _, result = _result(running, ball, outliers="mark", iterations="1")
    assert len(result) == 3000
    column = next(column for name, column in result.attributes.items() if "outlier" in name)
    assert np.flatnonzero(column).tolist() == [7, 1200]
    assert result.metadata["outliers"] == "mark"


def test_the_sensor_shows_flying_pixels_and_the_side_of_normals(running: Service, tmp_path: Path) -> None:
    points, kinds = depth_image()
    write(tmp_path / "frame.ply", PointCloud(points=points + np.array([5, 0, 0])))
    _, result = _result(running, tmp_path / "frame.ply", outliers="drop", sensor="5,0,0", iterations="1", orient="true")
    assert len(points) - len(result) == pytest.approx(kinds["flying"].sum(), rel=0.1)
    assert result.normals is not None
    assert (((result.points - [5, 0, 0]) * result.normals).sum(1) < 0).mean() > 0.9


def test_orient_follows_the_side_of_the_files_normals(running: Service, ball: Path) -> None:
    _, result = _result(running, ball, orient="true", outliers="drop")
    assert result.normals is not None
    assert ((result.points * result.normals).sum(1) < 0).mean() > 0.99  # the file's look inwards


def test_the_fast_form_is_told_and_refused_to_a_model_without(running: Service, ball: Path) -> None:
    job, result = _result(running, ball, iterations="1", fast="true")
    assert job["execution"]["plan"]["neighbours"] == 128  # type: ignore[index]
    assert result.metadata["fast"] == "128 neighbours"
    answer = running.client.post(
        "/denoise", files={"file": ("ball.ply", ball.read_bytes())}, data={"fast": "true", "model": "pcdnf"}
    )
    assert answer.status_code == 422
    assert answer.json()["code"] == "invalid_parameters"
    assert "no fast mode" in answer.json()["detail"]
