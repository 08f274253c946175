from __future__ import annotations

from typing import Any

import pytest

from service.jobs.files import DISPLAY, UPLOAD, job_file
from service.worker import workflow
from service.worker.context import Runtime, install
from service.worker.scheduler import Scheduler
from tests.support.board import Board


@pytest.mark.parametrize("ended", ["succeeded", "failed", "removed", "running"])
def test_what_a_late_worker_left_goes(board: Board, ended: str) -> None:
    models: Any = None
    install(Runtime(board.settings, board.storage, board.engine, models, Scheduler()))
    job = board.submit()
    board.attempts.acquire(job.id)
    for name in ("tiles/0-0-1.npz", "result-1.ply", "result-2.ply", DISPLAY):
        scratch = board.storage.scratch()
        scratch.write_bytes(b"x")
        board.storage.put(scratch, job_file(job.id, name))
    if ended == "failed":
        board.attempts.fail(job.id, {})
    elif ended != "running":
        board.attempts.succeed(job.id, {"ply": {"file": "result-1.ply", "size": 1, "sha256": ""}}, [])
    if ended == "removed":
        board.jobs.remove(job)
        scratch.write_bytes(b"x")
        board.storage.put(scratch, job_file(job.id, "tiles/0-0-2.npz"))
    assert workflow._end(job, None) == "gone"
    folder = board.settings.data_dir / "jobs" / job.id
    left = {path.name for path in folder.iterdir()} if folder.exists() else set()
    kept = {UPLOAD, "result-1.ply", DISPLAY}
    everything = kept | {"result-2.ply", "tiles"}
    assert left == {"succeeded": kept, "failed": set(), "removed": set(), "running": everything}[ended]


@pytest.mark.parametrize("ended", ["succeeded", "cancelled"])
def test_what_a_kill_left_after_the_end_goes(board: Board, ended: str) -> None:
    models: Any = None
    install(Runtime(board.settings, board.storage, board.engine, models, Scheduler()))
    job = board.submit()
    for name in ("tiles/0-0-1.npz", "result-1.ply"):
        scratch = board.storage.scratch()
        scratch.write_bytes(b"x")
        board.storage.put(scratch, job_file(job.id, name))
    if ended == "succeeded":
        board.attempts.acquire(job.id)
        board.attempts.succeed(job.id, {"ply": {"file": "result-1.ply", "size": 1, "sha256": ""}}, [])
    else:
        board.set(job.id, status="cancelled")
    assert workflow.denoise.__wrapped__(job.id) == "gone"  # type: ignore[attr-defined]
    folder = board.settings.data_dir / "jobs" / job.id
    left = {path.name for path in folder.iterdir()} if folder.exists() else set()
    assert left == ({UPLOAD, "result-1.ply"} if ended == "succeeded" else set())


def test_a_late_report_changes_no_job_that_has_ended(board: Board) -> None:
    job = board.submit(points=100)
    board.attempts.acquire(job.id)
    board.attempts.update(job.id, done=60)
    board.attempts.update(job.id, done=40)
    assert board.now(job).done == 60
    board.attempts.succeed(job.id, {}, [])
    board.attempts.update(job.id, done=40, execution={"late": True})
    assert (board.now(job).done, board.now(job).execution) == (100, None)
