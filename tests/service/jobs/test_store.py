from __future__ import annotations

import threading
from collections.abc import Callable

import pytest
import sqlalchemy as sa

from service.database.tables import jobs as table
from service.jobs.files import UPLOAD
from service.jobs.job import new_id
from service.storage.base import StorageError
from tests.support.board import Board


def test_ids_carry_128_random_bits() -> None:
    ids = {new_id() for _ in range(1000)}
    assert len(ids) == 1000
    assert all(len(job_id) == 32 and int(job_id, 16) >= 0 for job_id in ids)


def test_submit_enters_both_tables(board: Board) -> None:
    job = board.submit(points=100, iterations=3)
    assert (job.status, job.done, job.total) == ("queued", 0, 300)
    assert board.engine_state(job) == "ENQUEUED"
    assert board.jobs.status(job.id, "ada") == job
    assert board.jobs.status(job.id, "bob") is None
    assert board.jobs.status("0" * 32, "ada") is None


@pytest.mark.parametrize(("most", "guess"), [(1, 100), (2, 200), (4, 200)])
def test_auto_is_taken_for_no_more_iterations_than_there_may_be(
    make_board: Callable[..., Board], most: int, guess: int
) -> None:
    assert make_board(max_iterations=most).submit(points=100, iterations="auto").total == guess


def test_submit_is_one_transaction(board: Board, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise RuntimeError

    monkeypatch.setattr(board.jobs._client, "enqueue_in_transaction", broken)
    with pytest.raises(RuntimeError):
        board.submit()
    with board.engine.connect() as connection:
        assert connection.execute(sa.select(sa.func.count()).select_from(table)).scalar() == 0


def test_nothing_is_pickled(board: Board) -> None:
    job = board.submit()
    with board.engine.connect() as connection:
        inputs, serialization = connection.execute(
            sa.text(
                "SELECT i.inputs, s.serialization FROM workflow_status s JOIN workflow_input i USING (workflow_uuid)"
            )
        ).one()
    assert serialization == "portable_json"
    assert job.id in inputs


def test_many_at_once(board: Board) -> None:
    threads = [threading.Thread(target=board.submit) for _ in range(20)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(board.jobs.page("ada", limit=100)[0]) == 20


def test_pages_are_newest_first_and_the_callers_own(board: Board) -> None:
    jobs = [board.submit() for _ in range(5)]
    board.submit(owner="bob")
    expected = sorted(jobs, key=lambda job: (job.created_at, job.id), reverse=True)
    first = board.jobs.page("ada", limit=3)[0]
    assert first + board.jobs.page("ada", limit=3, before=first[-1])[0] == expected


def test_cancel_queued_goes_at_once(board: Board) -> None:
    job = board.submit()
    cancelled = board.jobs.cancel(job)
    assert cancelled is not None
    assert cancelled.status == "cancelled"
    assert cancelled.expires_at is not None
    assert board.engine_state(job) == "CANCELLED"
    assert not board.path(job, UPLOAD).exists()
    assert board.attempts.acquire(job.id) is None


def test_a_cancel_that_is_cut_off_is_the_workers_to_finish(board: Board, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_job_id: str) -> None:
        raise StorageError

    job = board.submit()
    monkeypatch.setattr(board.storage, "delete_job", broken)
    with pytest.raises(StorageError):
        board.jobs.cancel(job)
    assert board.now(job).status == "cancelled"
    assert board.engine_state(job) == "ENQUEUED"


def test_cancel_running_waits_for_the_worker(board: Board) -> None:
    job = board.submit()
    board.attempts.acquire(job.id)
    cancelled = board.jobs.cancel(job)  # the caller still thinks it is queued
    assert cancelled is not None
    assert cancelled.status == "cancelling"
    assert board.path(job, UPLOAD).exists()
    assert not board.attempts.report(job.id, done=1, points_per_second=None)
    assert not board.attempts.succeed(job.id, {}, [])
    assert not board.attempts.fail(job.id, {})
    assert board.attempts.cancel(job.id)
    assert board.now(job).status == "cancelled"


def test_cancel_that_comes_too_late(board: Board) -> None:
    job = board.submit()
    board.attempts.acquire(job.id)
    board.attempts.succeed(job.id, {}, [])
    late = board.jobs.cancel(job)
    assert late is not None
    assert late.status == "succeeded"


def test_remove(board: Board) -> None:
    job = board.submit()
    assert not board.jobs.remove(job)
    board.attempts.acquire(job.id)
    board.attempts.succeed(job.id, {}, [])
    assert board.jobs.remove(job)
    assert board.jobs.status(job.id, "ada") is None
    assert board.engine_state(job) is None
    assert not board.path(job, UPLOAD).exists()


def test_a_removal_that_is_cut_off_leaves_nothing_that_is_not_purged(
    board: Board, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(_job_id: str) -> None:
        raise StorageError

    job = board.submit()
    board.jobs.cancel(job)
    monkeypatch.setattr(board.storage, "delete_job", broken)
    with pytest.raises(StorageError):
        board.jobs.remove(job)
    assert board.engine_state(job) is None


def test_a_text_that_is_no_id_never_reaches_the_database(board: Board, monkeypatch: pytest.MonkeyPatch) -> None:
    job = board.submit()
    monkeypatch.setattr(board.jobs, "_engine", None)
    for text in ("", "\0", "a\0b", job.id.upper() + "A", job.id + "\n", "\udcff", "٣" * 32, "a" * 100_000):
        assert board.jobs.status(text, "ada") is None
