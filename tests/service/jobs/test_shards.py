from __future__ import annotations

import pytest
import sqlalchemy as sa

from service.database.tables import shares as table
from service.jobs.attempts import MAX_LOSSES
from service.jobs.job import Job
from service.jobs.shards import LEAST_SHARES, SHARE_TILES, Shares, cut, share_id
from tests.support.board import Board

PARTS = [[[0, 10], [10, 20]], [[20, 30], [30, 40]], [[40, 50]]]


@pytest.fixture
def shares(board: Board) -> Shares:
    """The table of a board."""
    return Shares(board.engine)


def _running(board: Board) -> Job:
    job = board.attempts.open(board.submit(points=50, iterations=2).id)
    assert job is not None
    return job


def _rows(board: Board) -> int:
    with board.engine.connect() as connection:
        return int(connection.execute(sa.select(sa.func.count()).select_from(table)).scalar_one())


def test_small_jobs_are_not_cut() -> None:
    tiles = [[first, first + 5] for first in range(0, 1000, 5)]
    assert cut(tiles[: SHARE_TILES * (LEAST_SHARES - 1)]) == []
    parts = cut(tiles[: SHARE_TILES * LEAST_SHARES + 1])
    assert [len(part) for part in parts] == [SHARE_TILES] * LEAST_SHARES + [1]
    assert [tile for part in parts for tile in part] == tiles[: SHARE_TILES * LEAST_SHARES + 1]


def test_one_job_at_a_time(board: Board, shares: Shares) -> None:
    first, second = _running(board), _running(board)
    assert shares.take(first.id, 0, 50, PARTS)
    assert shares.take(first.id, 0, 50, PARTS)  # after a crash
    assert _rows(board) == 3
    assert not shares.take(second.id, 0, 50, PARTS)
    shares.release(first.id)
    assert shares.take(second.id, 0, 50, PARTS)
    assert not shares.take(first.id, 1, 50, PARTS)
    board.attempts.fail(second.id, {})
    assert _rows(board) == 0
    assert shares.take(first.id, 1, 50, PARTS)


def test_progress_counts_every_share(board: Board, shares: Shares) -> None:
    job = _running(board)
    board.attempts.finished_tile(job.id, done=50, points_per_second=1.0)  # the first pass
    shares.take(job.id, 1, 50, PARTS)
    first, last = share_id(job.id, 1, 0), share_id(job.id, 1, 40)
    assert shares.wanted(last, done=50 + 40 + 7, points_per_second=3.0)
    assert board.now(job).done == 57
    assert shares.wanted(first, done=50 + 5, points_per_second=2.0)
    assert (board.now(job).done, board.now(job).points_per_second) == (62, 5.0)
    shares.finished_tile(first, done=50 + 10, points_per_second=2.0)
    assert board.now(job).done == 67
    shares.finished_tile(first, done=50 + 10, points_per_second=2.0)  # by a worker taken for dead
    assert shares.wanted(first, done=50 + 2, points_per_second=2.0)
    assert board.now(job).done == 67
    shares.park(last)
    assert shares.wanted(first, done=50 + 11, points_per_second=2.0)
    assert board.now(job).points_per_second == 2.0
    board.jobs.cancel(board.now(job))
    assert not shares.wanted(first, done=50 + 12, points_per_second=2.0)
    assert board.attempts.cancel(job.id)
    shares.finished_tile(last, done=50 + 50, points_per_second=2.0)  # too late
    assert board.now(job).done == 69


def test_deaths_count_for_the_share_they_happened_in(board: Board, shares: Shares) -> None:
    job = _running(board)
    shares.take(job.id, 0, 50, PARTS)
    bad, good = share_id(job.id, 0, 0), share_id(job.id, 0, 20)
    for lost in range(MAX_LOSSES + 1):
        opened = shares.open(bad)
        assert opened is not None
        assert (opened.id, opened.work, opened.losses) == (job.id, bad, lost)
        shares.finished_tile(good, done=30, points_per_second=None)  # forgives nothing of the other
    once = shares.open(good)
    assert once is not None
    assert once.losses == 0
    shares.park(good)
    parked = shares.open(good)
    assert parked is not None
    assert parked.losses == 0
    again = shares.open(good)
    assert again is not None
    assert again.losses == 1
    assert shares.part_of(job, good).losses == 1
    shares.finished_tile(good, done=40, points_per_second=None)
    assert shares.part_of(job, good).losses == 0
    assert board.now(job).losses == 0


def test_a_share_of_a_job_that_ended_is_not_taken_up(board: Board, shares: Shares) -> None:
    job = _running(board)
    shares.take(job.id, 0, 50, PARTS)
    board.jobs.cancel(board.now(job))
    assert shares.open(share_id(job.id, 0, 0)) is None
    board.attempts.cancel(job.id)
    assert shares.open(share_id(job.id, 0, 0)) is None
    board.jobs.remove(board.now(job))
    assert _rows(board) == 0
