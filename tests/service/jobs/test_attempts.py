from __future__ import annotations

from service.jobs.attempts import MAX_CRASHES
from tests.support.board import Board


def test_an_attempt_runs_the_job(board: Board) -> None:
    job = board.submit(points=100)
    opened = board.attempts.acquire(job.id)
    assert opened is not None
    assert (opened.status, opened.leased, opened.crashes) == ("running", True, 0)
    assert opened.started_at is not None
    assert board.attempts.report(job.id, done=10, points_per_second=5.0)
    assert (board.now(job).done, board.now(job).points_per_second) == (10, 5.0)
    assert board.attempts.report(job.id, done=3, points_per_second=5.0)
    assert board.now(job).done == 10  # a second attempt prepares the cloud anew, but nothing is lost
    assert board.attempts.live() == [job.id]
    assert board.attempts.succeed(job.id, {"ply": {}}, ["careful"])
    ended = board.now(job)
    assert (ended.status, ended.done, ended.leased, ended.warnings) == ("succeeded", 100, False, ["careful"])
    assert ended.finished_at is not None
    assert ended.expires_at == ended.finished_at + 1_000_000
    assert board.attempts.live() == []
    assert board.attempts.acquire(job.id) is None


def test_deaths_at_one_place_add_up(board: Board) -> None:
    job = board.submit()
    crashes = []
    for _ in range(MAX_CRASHES + 1):
        opened = board.attempts.acquire(job.id)
        assert opened is not None
        crashes.append(opened.crashes)
    assert crashes == [0, 1, 2]


def test_a_finished_tile_forgives(board: Board) -> None:
    job = board.submit()
    for _ in range(5):
        opened = board.attempts.acquire(job.id)
        assert opened is not None
        assert opened.crashes < MAX_CRASHES
        board.attempts.update(job.id, crashes=0)


def test_a_parked_job_is_no_loss(board: Board) -> None:
    job = board.submit()
    started = set()
    for _ in range(5):
        opened = board.attempts.acquire(job.id)
        assert opened is not None
        assert opened.crashes == 0
        started.add(opened.started_at)
        board.attempts.release(job.id)
    assert len(started) == 1


def test_only_one_end(board: Board) -> None:
    job = board.submit()
    board.attempts.acquire(job.id)
    assert board.attempts.fail(job.id, {"code": "x"})
    assert not board.attempts.succeed(job.id, {}, [])
    assert not board.attempts.cancel(job.id)
    assert not board.attempts.report(job.id, done=1, points_per_second=None)
    assert board.now(job).status == "failed"
    assert board.attempts.acquire("0" * 32) is None
