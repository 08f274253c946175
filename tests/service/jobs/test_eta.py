from __future__ import annotations

import pytest

from service.database.tables import now_ms, workers
from service.jobs.admission import Admission, Load
from service.jobs.eta import speed
from service.problems import Problem
from service.settings import Settings
from tests.support.board import Board


def _beat(board: Board, name: str = "w", speed: float = 50.0, state: str = "ready") -> None:
    board.workers.beat(name, pid=1, state=state, details={}, points_per_second=speed)


def test_nothing_is_known_before_a_speed_is(board: Board) -> None:
    job = board.submit()
    assert board.jobs.eta(job).seconds_left is None
    assert board.jobs.eta(job).queue_position == 1


def test_a_job_alone(board: Board) -> None:
    _beat(board)
    job = board.submit(points=100)
    assert board.jobs.eta(job).seconds_left == pytest.approx(2)
    board.attempts.acquire(job.id)
    board.attempts.report(job.id, done=40, points_per_second=30.0)
    assert board.jobs.eta(board.now(job)).seconds_left == pytest.approx(60 / 30)
    assert board.jobs.eta(board.now(job)).queue_position is None


def test_behind_others_of_its_size(board: Board) -> None:
    _beat(board)
    jobs = sorted((board.submit(points=100 * n) for n in (1, 2, 3)), key=lambda job: (job.created_at, job.id))
    board.submit(points=10**6)
    assert [board.jobs.eta(job).queue_position for job in jobs] == [1, 2, 3]
    assert board.jobs.eta(jobs[2]).seconds_left == pytest.approx(sum(job.total for job in jobs) / 50)


def test_shared_with_the_jobs_in_hand(board: Board) -> None:
    _beat(board)
    small, large = board.submit(points=100), board.submit(points=10**6)
    for job in (small, large):
        board.attempts.acquire(job.id)
        board.attempts.update(job.id, points_per_second=50.0)
    assert board.jobs.eta(board.now(small)).seconds_left == pytest.approx(200 / 50)
    assert board.jobs.eta(board.now(large)).seconds_left == pytest.approx((10**6 + 100) / 50)
    queued = board.submit(points=50)
    assert board.jobs.eta(queued).seconds_left == pytest.approx((50 + 50 + 50) / 50)
    _beat(board, "another")
    assert board.jobs.eta(board.now(small)).seconds_left == pytest.approx((100 + 100 / 2) / 50)


def test_workers_that_are_dead_start_or_stop_do_nothing(board: Board) -> None:
    job, running = board.submit(points=100), board.submit(points=100)
    board.attempts.acquire(running.id)
    for name in ("at work", "dead"):
        _beat(board, name)
    for state in ("starting", "stopping"):
        _beat(board, state, state=state)
    silence = int(1000 * (board.settings.worker_stale_seconds + 1))
    with board.engine.begin() as connection:
        connection.execute(workers.update().where(workers.c.id == "dead").values(beat_at=now_ms() - silence))
    assert board.jobs.eta(job).seconds_left == pytest.approx((100 + 100) / 50)
    assert board.jobs.eta(board.now(running)).seconds_left == pytest.approx(100 / 50)
    with board.engine.connect() as connection:
        assert speed(connection, board.settings.worker_stale_seconds) == 50
        with pytest.raises(Problem) as caught:
            Admission(Settings(max_caller_points=250)).check(connection, "ada", Load(100, 0, 1))
    assert caught.value.headers["Retry-After"] == "1"  # 50 points too many, at 50 a second


def test_a_finished_job(board: Board) -> None:
    _beat(board)
    job = board.jobs.cancel(board.submit())
    assert job is not None
    assert (board.jobs.eta(job).queue_position, board.jobs.eta(job).seconds_left) == (None, None)
