from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import sqlalchemy as sa

from service.api.intake.idempotency import Claims
from service.database.tables import idempotency
from service.jobs.files import UPLOAD
from service.jobs.job import Job
from service.problems import Problem
from tests.support.board import Board, MakeApi
from tests.support.service_process import Service


def _finished(board: Board, size: int = 100, status: str = "succeeded", owner: str = "ada") -> Job:
    """Return a job that has ended, whose files have so many bytes."""
    job = board.submit(owner=owner)
    board.attempts.acquire(job.id)
    if status == "succeeded":
        board.attempts.succeed(job.id, {}, [])
    else:
        board.attempts.fail(job.id, {})
    board.path(job, UPLOAD).write_bytes(bytes(size))
    time.sleep(0.002)  # or two end in the same millisecond
    return job


def _kept(board: Board, jobs: list[Job]) -> list[bool]:
    return [board.path(job, UPLOAD).exists() for job in jobs]


@pytest.mark.parametrize("status", ["succeeded", "failed"])
def test_every_finished_job_expires(board: Board, status: str) -> None:
    job = board.now(_finished(board, status=status))
    assert job.finished_at is not None
    assert job.expires_at == job.finished_at + 1_000_000


def test_the_oldest_results_make_room(make_board: Callable[..., Board]) -> None:
    board = make_board(disk_budget_bytes=1000)
    jobs = [_finished(board) for _ in range(5)]
    live = board.submit(size=100)
    board.retention.make_room(400)
    assert _kept(board, jobs) == [True] * 5
    board.retention.make_room(600)
    assert _kept(board, [*jobs, live]) == [False, False, True, True, True, True]
    gone = board.now(jobs[0])
    assert board.jobs.expired(gone)
    assert gone.purged_at is not None
    assert board.engine_state(gone) is None
    assert board.storage.used_bytes() <= 400


def test_results_of_who_has_most_go_first(make_board: Callable[..., Board]) -> None:
    board = make_board(disk_budget_bytes=1000)
    modest = [_finished(board, 200, owner="ada")]
    greedy = [_finished(board, owner="bob") for _ in range(6)]
    board.retention.make_room(600)
    assert _kept(board, modest) == [True]  # though it is the oldest
    assert _kept(board, greedy) == [False] * 4 + [True] * 2
    board.retention.make_room(700)  # both have as much
    assert _kept(board, modest + greedy[4:]) == [False, True, True]


def test_nothing_goes_in_vain(make_board: Callable[..., Board]) -> None:
    board = make_board(disk_budget_bytes=1000)
    jobs = [_finished(board) for _ in range(3)]
    with pytest.raises(Problem) as caught:
        board.retention.make_room(1001)
    assert (caught.value.code, caught.value.status) == ("disk_full", 503)
    assert caught.value.members["limit"] == 1000
    assert caught.value.members["actual"] == 1301
    assert caught.value.headers["Retry-After"]
    assert _kept(board, jobs) == [True] * 3


def test_a_full_disk_counts_as_well(board: Board, monkeypatch: pytest.MonkeyPatch) -> None:
    jobs = [_finished(board) for _ in range(3)]
    monkeypatch.setattr(board.storage, "free_bytes", lambda: board.settings.min_free_bytes + 50)
    board.retention.make_room(200)
    assert _kept(board, jobs) == [False, False, True]
    with pytest.raises(Problem) as caught:
        board.retention.make_room(500)
    assert caught.value.members["limit"] == board.settings.min_free_bytes + 50


def test_over_http(make_api: MakeApi, small: Path) -> None:
    size = small.stat().st_size
    api = make_api(disk_budget_bytes=int(2.5 * size))
    assert [api.post("/denoise", files={"file": small.read_bytes()}).status_code for _ in range(3)] == [202, 202, 503]
    refused = api.post("/denoise", files={"file": small.read_bytes()})
    assert refused.json()["code"] == "disk_full"
    assert refused.json()["limit"] == int(2.5 * size)
    api.delete(f"/jobs/{api.get('/jobs').json()[0]['id']}")
    assert api.post("/denoise", files={"file": small.read_bytes()}).status_code == 202


def test_an_upload_that_does_not_tell_its_length_keeps_to_the_budget(make_api: MakeApi, small: Path) -> None:
    size = small.stat().st_size
    api = make_api(disk_budget_bytes=int(2.5 * size))
    headers = {"Content-Type": "application/ply"}

    def post() -> int:
        return api.post("/denoise", content=iter([small.read_bytes()]), headers=headers).status_code

    assert [post() for _ in range(3)] == [202, 202, 503]
    assert len(api.get("/jobs").json()) == 2


def test_an_api_without_a_worker_clears_its_scratch(
    make_api: MakeApi, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("service.api.app.CLEAR_SECONDS", 0.2)
    scratch = tmp_path / "data" / "scratch"
    scratch.mkdir(parents=True)

    def left() -> set[str]:
        return {path.name for path in scratch.iterdir()}

    def wait_for_old_to_go() -> None:
        (scratch / "old").touch()
        os.utime(scratch / "old", (1, 1))
        deadline = time.monotonic() + 20
        while "old" in left():
            assert time.monotonic() < deadline
            time.sleep(0.02)

    (scratch / "new").touch()
    make_api()
    for _ in range(2):
        wait_for_old_to_go()
    assert left() == {"new"}


def test_the_worker_looks_after_it(tmp_path: Path, small: Path) -> None:
    service = Service(tmp_path / "service", job_ttl=2).start()
    job = service.wait_status(service.submit(small)["id"], "succeeded")
    assert job["expires_at"] > job["finished_at"]
    deadline = time.monotonic() + 20
    while (service.data / "jobs" / job["id"]).exists():
        assert time.monotonic() < deadline
        time.sleep(0.1)
    for link in (job["links"]["self"], job["links"]["result"]):
        response = service.client.get(link)
        assert (response.status_code, response.json()["code"]) == (410, "job_expired")
    assert service.stop() == 0, service.output()


def test_purge_keeps_the_row_of_an_expired_job_for_a_while(board: Board) -> None:
    kept, expired, live = board.submit(), board.submit(), board.submit()
    for job in (kept, expired):
        board.attempts.acquire(job.id)
        board.attempts.succeed(job.id, {}, [])
    board.set(expired.id, expires_at=1)
    assert board.jobs.expired(board.now(expired))
    assert not board.jobs.expired(board.now(kept))
    assert not board.jobs.expired(live)
    assert board.retention.purge() == 1
    assert board.retention.purge() == 0
    assert not board.path(expired, UPLOAD).exists()
    assert board.path(kept, UPLOAD).exists()
    assert board.engine_state(expired) is None
    assert board.now(expired).purged_at is not None
    assert {job.id for job in board.jobs.page("ada", limit=9)[0]} == {kept.id, live.id}
    board.set(expired.id, purged_at=1)
    board.retention.purge()
    assert board.attempts.get(expired.id) is None


def test_purge_removes_keys_that_never_had_a_job(board: Board) -> None:
    claims = Claims(board.engine)
    kept, old = (claims.claim("ada", key) for key in ("kept", "old"))
    with board.engine.begin() as connection:
        long_ago = idempotency.update().where(idempotency.c.key == old.key).values(lease_until=1)
        connection.execute(long_ago)
    board.retention.purge()
    with board.engine.connect() as connection:
        assert list(connection.execute(sa.select(idempotency.c.key)).scalars()) == [kept.key]


def test_purge_removes_uploads_that_were_never_accepted(board: Board) -> None:
    job = board.submit()
    folder = board.settings.data_dir / "jobs"
    (folder / "orphan").mkdir()
    for name in ("orphan", job.id):
        os.utime(folder / name, (1, 1))
    board.retention.purge()
    assert [path.name for path in folder.iterdir()] == [job.id]
