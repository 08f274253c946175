from __future__ import annotations

import pytest
import sqlalchemy as sa

from service.database.tables import shards as table
from service.jobs.attempts import MAX_CRASHES
from service.jobs.job import Job
from service.jobs.shards import LEAST_SHARDS, SHARD_TILES, Shards, cut, shard_id
from tests.support.board import Board

PARTS = [[[0, 10], [10, 20]], [[20, 30], [30, 40]], [[40, 50]]]


@pytest.fixture
def shards(board: Board) -> Shards:
    """The table of a board."""
    return Shards(board.engine)


def _running(board: Board) -> Job:
    job = board.attempts.acquire(board.submit(points=50, iterations=2).id)
    assert job is not None
    return job


def _rows(board: Board) -> int:
    with board.engine.connect() as connection:
        return int(connection.execute(sa.select(sa.func.count()).select_from(table)).scalar_one())


def test_small_jobs_are_not_cut() -> None:
    tiles = [[first, first + 5] for first in range(0, 1000, 5)]
    assert cut(tiles[: SHARD_TILES * (LEAST_SHARDS - 1)]) == []
    parts = cut(tiles[: SHARD_TILES * LEAST_SHARDS + 1])
    assert [len(part) for part in parts] == [SHARD_TILES] * LEAST_SHARDS + [1]
    assert [tile for part in parts for tile in part] == tiles[: SHARD_TILES * LEAST_SHARDS + 1]


def test_one_job_at_a_time(board: Board, shards: Shards) -> None:
    first, second = _running(board), _running(board)
    assert shards.begin(first.id, 0, 50, PARTS)
    assert shards.begin(first.id, 0, 50, PARTS)  # after a crash
    assert _rows(board) == 3
    assert not shards.begin(second.id, 0, 50, PARTS)
    shards.finish(first.id)
    assert shards.begin(second.id, 0, 50, PARTS)
    assert not shards.begin(first.id, 1, 50, PARTS)
    board.attempts.fail(second.id, {})
    assert _rows(board) == 0
    assert shards.begin(first.id, 1, 50, PARTS)


def test_progress_counts_every_share(board: Board, shards: Shards) -> None:
    job = _running(board)
    board.attempts.finished_tile(job.id, done=50, points_per_second=1.0)  # the first pass
    shards.begin(job.id, 1, 50, PARTS)
    first, last = shard_id(job.id, 1, 0), shard_id(job.id, 1, 40)
    assert shards.report(last, done=50 + 40 + 7, points_per_second=3.0)
    assert board.now(job).done == 57
    assert shards.report(first, done=50 + 5, points_per_second=2.0)
    assert (board.now(job).done, board.now(job).points_per_second) == (62, 5.0)
    shards.finished_tile(first, done=50 + 10, points_per_second=2.0)
    assert board.now(job).done == 67
    shards.finished_tile(first, done=50 + 10, points_per_second=2.0)  # by a worker taken for dead
    assert shards.report(first, done=50 + 2, points_per_second=2.0)
    assert board.now(job).done == 67
    shards.release(last)
    assert shards.report(first, done=50 + 11, points_per_second=2.0)
    assert board.now(job).points_per_second == 2.0
    board.jobs.cancel(board.now(job))
    assert not shards.report(first, done=50 + 12, points_per_second=2.0)
    assert board.attempts.cancel(job.id)
    shards.finished_tile(last, done=50 + 50, points_per_second=2.0)  # too late
    assert board.now(job).done == 69


def test_deaths_count_for_the_share_they_happened_in(board: Board, shards: Shards) -> None:
    job = _running(board)
    shards.begin(job.id, 0, 50, PARTS)
    bad, good = shard_id(job.id, 0, 0), shard_id(job.id, 0, 20)
    for lost in range(MAX_CRASHES + 1):
        opened = shards.acquire(bad)
        assert opened is not None
        assert (opened.id, opened.work, opened.crashes) == (job.id, bad, lost)
        shards.finished_tile(good, done=30, points_per_second=None)  # forgives nothing of the other
    once = shards.acquire(good)
    assert once is not None
    assert once.crashes == 0
    shards.release(good)
    parked = shards.acquire(good)
    assert parked is not None
    assert parked.crashes == 0
    again = shards.acquire(good)
    assert again is not None
    assert again.crashes == 1
    assert shards.part_of(job, good).crashes == 1
    shards.finished_tile(good, done=40, points_per_second=None)
    assert shards.part_of(job, good).crashes == 0
    assert board.now(job).crashes == 0


def test_a_share_of_a_job_that_ended_is_not_taken_up(board: Board, shards: Shards) -> None:
    job = _running(board)
    shards.begin(job.id, 0, 50, PARTS)
    board.jobs.cancel(board.now(job))
    assert shards.acquire(shard_id(job.id, 0, 0)) is None
    board.attempts.cancel(job.id)
    assert shards.acquire(shard_id(job.id, 0, 0)) is None
    board.jobs.remove(board.now(job))
    assert _rows(board) == 0
