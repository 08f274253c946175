"""A service that an older version left with jobs in its queue; ``tests/data/record_queue.py`` says how it was made."""

from __future__ import annotations

import io
import re
import tarfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.service_process import Service

RECORDED = Path(__file__).parents[1] / "data" / "queue-1445ba2.tar.xz"
JOBS = {"finished", "begun", "shared", "waiting"}


@pytest.fixture(scope="module")
def upgraded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """Today's service on the data folder of the old one."""
    folder = tmp_path_factory.mktemp("upgraded")
    with tarfile.open(RECORDED) as archive:
        archive.extractall(folder, filter="data")
    service = Service(folder, worker_stale_seconds=2).start()
    yield service
    assert service.stop() == 0, service.output()


@pytest.fixture(scope="module")
def jobs(upgraded: Service) -> list[dict[str, Any]]:
    """The jobs of the old service, each waited for."""
    found = upgraded.client.get("/jobs").json()
    return [upgraded.wait_status(job["id"], "succeeded", "failed", "cancelled", seconds=300) for job in found]


def _arrays(service: Service, job: dict[str, Any]) -> dict[str, np.ndarray[Any, Any]]:
    content = service.client.get(f"/jobs/{job['id']}/result", params={"format": "npz"}).content
    with np.load(io.BytesIO(content), allow_pickle=False) as file:
        return dict(file)


def test_every_job_of_an_older_version_is_finished(upgraded: Service, jobs: list[dict[str, Any]]) -> None:
    assert len(jobs) == 6
    assert {job["upload"]["name"] for job in jobs} == JOBS
    for job in jobs:
        assert job["status"] == "succeeded", job["problem"]
        assert job["progress"]["done"] == job["progress"]["total"]
        points = _arrays(upgraded, job)["points"]
        assert len(points) == job["upload"]["points"]
        assert np.abs(np.linalg.norm(points, axis=1) - 1).max() < 0.1  # each was a sphere


def test_a_result_of_an_older_version_stays(upgraded: Service, jobs: list[dict[str, Any]]) -> None:
    (finished,) = (job for job in jobs if job["upload"]["name"] == "finished")
    assert f"job {finished['id']}" not in upgraded.output()
    assert upgraded.client.get(f"/jobs/{finished['id']}/result").status_code == 200
    assert upgraded.client.get(f"/jobs/{finished['id']}/display").status_code == 200


def test_a_job_that_was_begun_goes_on_at_its_first_missing_tile(upgraded: Service, jobs: list[dict[str, Any]]) -> None:
    (begun,) = (job for job in jobs if job["upload"]["name"] == "begun")
    tiles = re.findall(rf"job {begun['id']} iteration (\d tile \d+)-", upgraded.output())
    assert tiles in (["1 tile 512"], ["1 tile 256", "1 tile 512"])  # the checkpoint of the last one may be cut off
