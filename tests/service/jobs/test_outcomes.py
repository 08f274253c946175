from __future__ import annotations

import threading

from service.jobs import outcomes
from tests.support.board import Board


def _counted(board: Board) -> dict[tuple[str, str], int]:
    with board.engine.connect() as connection:
        return outcomes.counted(connection)


def test_every_end_is_counted_once(board: Board) -> None:
    succeeds, fails, cancelled, dequeued = (board.submit() for _ in range(4))
    for job in (succeeds, fails, cancelled):
        board.attempts.acquire(job.id)
    assert board.attempts.succeed(succeeds.id, {}, [])
    assert not board.attempts.succeed(succeeds.id, {}, [])
    assert board.attempts.fail(fails.id, {"code": "worker_lost"})
    board.jobs.cancel(board.now(cancelled))
    assert board.attempts.cancel(cancelled.id)
    board.jobs.cancel(dequeued)
    board.jobs.remove(board.now(succeeds))  # what has been counted stays
    assert _counted(board) == {("succeeded", ""): 1, ("failed", "worker_lost"): 1, ("cancelled", ""): 2}


def test_counting_at_the_same_time(board: Board) -> None:
    def count() -> None:
        for _ in range(20):
            with board.engine.begin() as connection:
                outcomes.count(connection, "succeeded")

    threads = [threading.Thread(target=count) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert _counted(board) == {("succeeded", ""): 80}
