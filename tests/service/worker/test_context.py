from __future__ import annotations

import threading
import time
from typing import Any

import pytest

from service.jobs.job import Job
from service.worker.context import Runtime
from service.worker.scheduler import Scheduler
from tests.support.board import Board


class CrashError(Exception):
    """The process of a test crashed."""


def _nothing() -> None:
    pass


def _crashes() -> None:
    raise CrashError


def _runtime(board: Board) -> Runtime:
    """Return what a worker process that has just been started works with; no test here loads a model."""
    models: Any = None
    return Runtime(board.settings, board.storage, board.engine, models, Scheduler())


def _open(board: Board, job: Job) -> Job:
    opened = board.attempts.acquire(job.id)
    assert opened is not None
    return opened


def test_a_job_that_waits_is_not_to_blame(board: Board, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.worker.scheduler.POLL_SECONDS", 0.02)
    guilty, innocent = board.submit(), board.submit()
    for crashes, left in ((0, 50), (1, None)):  # a suspect keeps even those waiting that need no turn
        runtime = _runtime(board)
        first, second = _open(board, guilty), _open(board, innocent)
        assert [first.crashes, second.crashes] == [crashes, 0]
        with runtime.at_work(first, _nothing, left=100):
            with pytest.raises(CrashError), runtime.at_work(second, _crashes, left=left):
                pytest.fail("two at a time")
            assert [board.now(job).leased for job in (guilty, innocent)] == [True, False]
    assert [_open(board, job).crashes for job in (guilty, innocent)] == [2, 0]


def test_a_job_at_work_after_it_waited_is(board: Board) -> None:
    runtime = _runtime(board)
    first, second = _open(board, board.submit()), _open(board, board.submit())
    seen = []

    def work() -> None:
        with runtime.at_work(second, _nothing, left=50):
            seen.append(board.now(second).leased)

    thread = threading.Thread(target=work)
    with runtime.at_work(first, _nothing, left=100):
        thread.start()
        deadline = time.monotonic() + 5
        while board.now(second).leased and time.monotonic() < deadline:
            time.sleep(0.01)
        assert not board.now(second).leased
    thread.join(5)
    assert seen == [True]


def test_a_job_that_gives_way_is_not_to_blame_meanwhile(board: Board) -> None:
    runtime = _runtime(board)
    large, small = _open(board, board.submit()), _open(board, board.submit())
    seen = []

    def work() -> None:
        with runtime.at_work(small, _nothing, left=50):
            time.sleep(0.1)
            seen.extend(board.now(job).leased for job in (large, small))

    thread = threading.Thread(target=work)
    with runtime.at_work(large, _nothing, left=100) as yield_to_smaller:
        assert yield_to_smaller() == 0
        thread.start()
        deadline = time.monotonic() + 5
        while not (seconds := yield_to_smaller()) and time.monotonic() < deadline:
            time.sleep(0.01)
        assert seconds >= 0.1
        assert seen == [False, True]
        assert board.now(large).leased
    thread.join(5)


def test_those_that_wait_are_at_rest_once_it_stops(board: Board, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.worker.scheduler.POLL_SECONDS", 0.02)
    runtime = _runtime(board)
    working, waiting = _open(board, board.submit()), _open(board, board.submit())

    def wait() -> None:
        with runtime.working_on(waiting.id, waiting.id), runtime.at_work(waiting, _nothing, left=1):
            pytest.fail("it began after the stop")

    with runtime.working_on(working.id, working.id), runtime.at_work(working, _nothing, left=100):
        threading.Thread(target=wait, daemon=True).start()  # for good, as in a process that ends
        runtime.stop()
        deadline = time.monotonic() + 5
        while waiting.id not in runtime.in_flight.released and time.monotonic() < deadline:
            time.sleep(0.01)
        assert runtime.in_flight.released == {waiting.id}
        assert not runtime.in_flight.at_rest  # the tile in hand is still finished
    assert runtime.in_flight.at_rest
    assert not board.now(waiting).leased


def test_what_ends_while_the_rest_is_let_go_of(board: Board, monkeypatch: pytest.MonkeyPatch) -> None:
    runtime = _runtime(board)
    jobs = [_open(board, board.submit()) for _ in range(2)]
    works = [runtime.working_on(job.id, job.id) for job in jobs]
    for work in works:
        work.__enter__()
    release = runtime.attempts.release

    def slow_release(job_id: str) -> None:
        release(job_id)
        (other,) = (work for job, work in zip(jobs, works, strict=True) if job.id != job_id)
        other.__exit__(None, None, None)

    monkeypatch.setattr(runtime.attempts, "release", slow_release)
    runtime.in_flight.release_rest()
    assert len(runtime.in_flight.released) == 1
