from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from pcdnf.formats import PointCloud, write
from service.jobs.files import UPLOAD
from service.jobs.job import Job
from service.settings import Settings
from service.worker import steps
from service.worker.context import Runtime, install
from service.worker.model_cache import ModelCache
from service.worker.scheduler import Scheduler
from tests.support.board import Board
from tests.support.service_process import sphere

POINTS = 500


def _surveyed(board: Board, iterations: int | str) -> Job:
    """Return a job on a very noisy cloud, after its survey."""
    job = board.submit(points=POINTS, iterations=iterations)
    points = sphere(POINTS) + 0.2 * np.random.default_rng(1).normal(size=(POINTS, 3))
    write(board.path(job, UPLOAD), PointCloud(points=points), format="ply")
    given = {"radius": "auto", "model": "pcdnf-lite", "nonfinite": "reject", "outliers": "keep"}
    board.set(job.id, parameters=job.parameters | given)
    board.attempts.acquire(job.id)
    install(Runtime(board.settings, board.storage, board.engine, ModelCache(Settings(device="cpu")), Scheduler()))
    told = steps.survey(job.id)
    now = board.now(job)
    assert now.execution is not None
    assert told == {"iterations": len(now.execution["plan"]["radii"])}
    return now


@pytest.mark.parametrize(
    ("most", "iterations", "runs"), [(4, "auto", 2), (1, "auto", 1), (4, 3, 3), (1, 3, 3)]
)  # a job that was accepted with three keeps them
def test_auto_keeps_to_the_most_there_may_be(
    make_board: Callable[..., Board], most: int, iterations: int | str, runs: int
) -> None:
    job = _surveyed(make_board(max_iterations=most), iterations)
    assert job.total == runs * POINTS
    assert job.execution is not None
    assert len(job.execution["plan"]["radii"]) == runs
