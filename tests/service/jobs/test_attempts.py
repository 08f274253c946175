from __future__ import annotations

from service.jobs.attempts import MAX_LOSSES
from tests.support.board import Board


def test_an_attempt_runs_the_job(board: Board) -> None:
    job = board.submit(points=100)
    opened = board.attempts.open(job.id)
    assert opened is not None
    assert (opened.status, opened.open, opened.losses) == ("running", True, 0)
    assert opened.started_at is not None
    assert board.attempts.wanted(job.id, done=10, points_per_second=5.0)
    assert (board.now(job).done, board.now(job).points_per_second) == (10, 5.0)
    assert board.attempts.wanted(job.id, done=3, points_per_second=5.0)
    assert board.now(job).done == 10  # a second attempt prepares the cloud anew, but nothing is lost
    assert board.attempts.live() == [job.id]
    assert board.attempts.succeed(job.id, {"ply": {}}, ["careful"])
    ended = board.now(job)
    assert (ended.status, ended.done, ended.open, ended.warnings) == ("succeeded", 100, False, ["careful"])
    assert ended.finished_at is not None
    assert ended.expires_at == ended.finished_at + 1_000_000
    assert board.attempts.live() == []
    assert board.attempts.open(job.id) is None


def test_deaths_at_one_place_add_up(board: Board) -> None:
    job = board.submit()
    losses = []
    for _ in range(MAX_LOSSES + 1):
        opened = board.attempts.open(job.id)
        assert opened is not None
        losses.append(opened.losses)
    assert losses == [0, 1, 2]


def test_a_finished_tile_forgives(board: Board) -> None:
    job = board.submit()
    for _ in range(5):
        opened = board.attempts.open(job.id)
        assert opened is not None
        assert opened.losses < MAX_LOSSES
        board.attempts.update(job.id, losses=0)


def test_a_parked_job_is_no_loss(board: Board) -> None:
    job = board.submit()
    started = set()
    for _ in range(5):
        opened = board.attempts.open(job.id)
        assert opened is not None
        assert opened.losses == 0
        started.add(opened.started_at)
        board.attempts.park(job.id)
    assert len(started) == 1


def test_only_one_end(board: Board) -> None:
    job = board.submit()
    board.attempts.open(job.id)
    assert board.attempts.fail(job.id, {"code": "x"})
    assert not board.attempts.succeed(job.id, {}, [])
    assert not board.attempts.cancel(job.id)
    assert not board.attempts.wanted(job.id, done=1, points_per_second=None)
    assert board.now(job).status == "failed"
    assert board.attempts.open("0" * 32) is None
