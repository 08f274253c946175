from __future__ import annotations

import pytest
from board import Board


def _beat(board: Board, name: str = "w", speed: float = 50.0) -> None:
    board.workers.beat(name, pid=1, state="ready", details={}, points_per_second=speed)


def test_nothing_is_known_before_a_speed_is(board: Board) -> None:
    job = board.submit()
    assert board.jobs.outlook(job).seconds_left is None
    assert board.jobs.outlook(job).queue_position == 1


def test_a_job_alone(board: Board) -> None:
    _beat(board)
    job = board.submit(points=100)
    assert board.jobs.outlook(job).seconds_left == pytest.approx(2)
    board.attempts.open(job.id)
    board.attempts.wanted(job.id, done=40, points_per_second=30.0)
    assert board.jobs.outlook(board.now(job)).seconds_left == pytest.approx(60 / 30)
    assert board.jobs.outlook(board.now(job)).queue_position is None


def test_behind_others_of_its_size(board: Board) -> None:
    _beat(board)
    jobs = sorted((board.submit(points=100 * n) for n in (1, 2, 3)), key=lambda job: (job.created_at, job.id))
    board.submit(points=10**6)
    assert [board.jobs.outlook(job).queue_position for job in jobs] == [1, 2, 3]
    assert board.jobs.outlook(jobs[2]).seconds_left == pytest.approx(sum(job.total for job in jobs) / 50)


def test_shared_with_the_jobs_in_hand(board: Board) -> None:
    _beat(board)
    small, large = board.submit(points=100), board.submit(points=10**6)
    for job in (small, large):
        board.attempts.open(job.id)
        board.attempts.update(job.id, points_per_second=50.0)
    assert board.jobs.outlook(board.now(small)).seconds_left == pytest.approx(200 / 50)
    assert board.jobs.outlook(board.now(large)).seconds_left == pytest.approx((10**6 + 100) / 50)
    queued = board.submit(points=50)
    assert board.jobs.outlook(queued).seconds_left == pytest.approx((50 + 50 + 50) / 50)
    _beat(board, "another")
    assert board.jobs.outlook(board.now(small)).seconds_left == pytest.approx((100 + 100 / 2) / 50)


def test_a_finished_job(board: Board) -> None:
    _beat(board)
    job = board.jobs.cancel(board.submit())
    assert job is not None
    assert (board.jobs.outlook(job).queue_position, board.jobs.outlook(job).seconds_left) == (None, None)
