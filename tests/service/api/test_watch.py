from __future__ import annotations

import asyncio
import threading
import time

import pytest
from sqlalchemy.exc import OperationalError

from service.api.watch import LOOK_SECONDS, Watch
from service.jobs.eta import Eta
from service.problems import Problem
from tests.support.board import Board


class Counted(Watch):
    """A watch that counts its looks, the first of which may fail."""

    def __init__(self, board: Board, most: int = 1000, fails: int = 0) -> None:
        super().__init__(board.jobs, most)
        self.looks = 0

        def seen(job_ids: set[str]) -> object:
            self.looks += 1
            if self.looks <= fails:
                raise OperationalError("SELECT", {}, Exception())
            return type(board.jobs).seen(board.jobs, job_ids)

        board.jobs.seen = seen  # type: ignore[method-assign,assignment]


def test_waiting_costs_no_thread_and_one_look_for_all(board: Board) -> None:
    jobs = [board.submit() for _ in range(3)]

    async def main() -> None:
        watch = Counted(board)
        waiting = [asyncio.create_task(watch.finished(jobs[n % 3], 30)) for n in range(300)]
        await asyncio.sleep(1.0)
        assert threading.active_count() < 20
        assert watch.looks <= 1 + 1.0 / LOOK_SECONDS
        for job in jobs:
            board.attempts.acquire(job.id)
            board.attempts.succeed(job.id, {}, [])
        began = time.monotonic()
        ended = await asyncio.gather(*waiting)
        assert time.monotonic() - began < 2
        assert {job.status for job in ended} == {"succeeded"}
        await asyncio.sleep(2 * LOOK_SECONDS)
        looks = watch.looks
        await asyncio.sleep(2 * LOOK_SECONDS)
        assert watch.looks == looks  # nobody waits, nobody looks

    asyncio.run(main())


def test_it_gives_up_at_its_time(board: Board) -> None:
    job = board.submit()
    began = time.monotonic()
    assert asyncio.run(Counted(board).finished(job, 0.5)).status == "queued"
    assert 0.5 <= time.monotonic() - began < 2


def test_a_finished_job_needs_no_look(board: Board) -> None:
    job = board.submit()
    cancelled = board.jobs.cancel(job)
    assert cancelled is not None
    watch = Counted(board)
    assert asyncio.run(watch.finished(cancelled, 30)) == cancelled
    assert watch.looks == 0


def test_a_job_that_goes_away(board: Board) -> None:
    job = board.submit()

    async def main() -> None:
        waiting = asyncio.create_task(Counted(board).finished(job, 30))
        await asyncio.sleep(0.1)
        board.jobs.cancel(job)
        board.jobs.remove(job)
        await asyncio.wait_for(waiting, 5)

    asyncio.run(main())


def test_the_database_may_stumble(board: Board) -> None:
    job = board.submit()

    async def main() -> None:
        watch = Counted(board, fails=2)
        waiting = asyncio.create_task(watch.finished(job, 30))
        await asyncio.sleep(0.1)
        board.jobs.cancel(job)
        assert (await asyncio.wait_for(waiting, 10)).status == "cancelled"
        assert watch.looks > 2

    asyncio.run(main())


def test_bounded_and_closed(board: Board) -> None:
    job = board.submit()
    nothing = Eta(None, None)

    async def main() -> None:
        watch = Counted(board, most=1)
        with watch.following(job, nothing) as follower:
            assert watch.full
            with pytest.raises(Problem) as caught, watch.following(job, nothing):
                pass
            assert (caught.value.code, caught.value.members["limit"]) == ("too_busy", 1)
            assert not follower.ended
            watch.close()
            assert follower.ended
            assert await follower.change(1)
        assert not watch.full
        with watch.following(job, nothing) as follower:
            assert follower.ended

    asyncio.run(main())
