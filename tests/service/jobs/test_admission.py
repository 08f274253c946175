from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from service.jobs.admission import Load
from service.problems import Problem
from tests.support.board import Board, MakeApi, submit_at_once


def _refused(board: Board, **job: Any) -> Problem:
    with pytest.raises(Problem) as caught:
        board.submit(**job)
    return caught.value


def test_the_queue_is_bounded_in_points(make_board: Callable[..., Board]) -> None:
    board = make_board(max_queued_points=1000, max_caller_points=1000)
    first = board.submit(owner="ada", points=300, iterations=2)
    board.submit(owner="bob", points=400)
    problem = _refused(board, owner="eve", points=1)
    assert (problem.code, problem.status) == ("queue_full", 503)
    assert {"limit": 1000, "actual": 1001, "unit": "points"}.items() <= problem.members.items()
    assert problem.members["hint"]
    board.attempts.acquire(first.id)
    board.attempts.report(first.id, done=100, points_per_second=None)  # what is done makes room
    board.submit(owner="eve", points=100)
    assert _refused(board, owner="eve", points=1).code == "queue_full"
    board.attempts.succeed(first.id, {}, [])
    board.submit(owner="eve", points=500)


def test_the_queue_is_bounded_in_bytes(make_board: Callable[..., Board]) -> None:
    board = make_board(max_queued_bytes=1000)
    board.submit(owner="ada", size=1000)
    problem = _refused(board, owner="bob", size=1)
    assert (problem.code, problem.members["unit"], problem.members["actual"]) == ("queue_full", "bytes", 1001)


@pytest.mark.parametrize(
    ("settings", "job", "unit"),
    [
        ({"max_caller_points": 300}, {"points": 100, "iterations": 2}, "points"),
        ({"max_caller_bytes": 300}, {"size": 200}, "bytes"),
        ({"max_caller_jobs": 1}, {}, "jobs"),
    ],
)
def test_a_caller_has_limits_of_its_own(
    make_board: Callable[..., Board], settings: dict[str, int], job: dict[str, int], unit: str
) -> None:
    board = make_board(**settings)
    mine = board.submit(owner="ada", **job)
    problem = _refused(board, owner="ada", **job)
    assert (problem.code, problem.status, problem.members["unit"]) == ("quota_exceeded", 429, unit)
    assert problem.members["limit"] < problem.members["actual"]
    board.submit(owner="bob", **job)
    board.jobs.cancel(mine)
    board.submit(owner="ada", **job)


def test_exact_however_many_come_at_once(make_board: Callable[..., Board]) -> None:
    board = make_board(max_queued_points=1000, max_caller_points=1000)
    accepted, refused = submit_at_once(board, 40, points=99)
    assert (len(accepted), refused) == (10, ["queue_full"] * 30)
    with ThreadPoolExecutor(20) as pool:  # the same for one caller
        board.jobs._admission._caller = Load(10**9, 10**9, 10)
        board.jobs._admission._all = Load(10**9, 10**9)
        codes = list(pool.map(lambda _: _code(board), range(20)))
    assert codes.count(None) == 10


def _code(board: Board) -> str | None:
    try:
        board.submit(owner="one")
    except Problem as problem:
        return problem.code
    return None


def test_retry_after_comes_from_the_measured_speed(make_board: Callable[..., Board]) -> None:
    board = make_board(max_queued_points=1000, max_caller_points=1000)
    board.submit(points=1000)
    assert _refused(board, owner="bob", points=500).headers["Retry-After"] == "30"
    board.workers.beat("w", pid=1, state="ready", details={}, points_per_second=20.0)
    assert _refused(board, owner="bob", points=500).headers["Retry-After"] == "25"
    assert _refused(board, owner="bob", points=1).headers["Retry-After"] == "1"
    assert _refused(board, owner="ada", points=100).headers["Retry-After"] == "5"


def test_what_never_fits_is_not_asked_to_come_back(make_board: Callable[..., Board]) -> None:
    board = make_board(max_caller_points=300, max_caller_bytes=50)
    problem = _refused(board, points=100, iterations=4)
    assert (problem.code, problem.status, problem.headers) == ("too_much_work", 413, {})
    assert (problem.members["limit"], problem.members["actual"]) == (300, 400)
    assert _refused(board, size=51).code == "upload_too_large"


def test_over_http(make_api: MakeApi, small: Path) -> None:
    api = make_api(max_queued_points=5000, max_caller_jobs=1)
    first = api.post("/denoise", files={"file": small.read_bytes()})
    assert first.status_code == 202
    response = api.post("/denoise", content=b"not even looked at", headers={"Content-Type": "application/ply"})
    assert (response.status_code, response.json()["code"]) == (429, "quota_exceeded")
    assert int(response.headers["retry-after"]) > 0
    api.delete(f"/jobs/{first.json()['id']}")
    assert api.post("/denoise", files={"file": small.read_bytes()}).status_code == 202


def test_a_refused_upload_leaves_nothing(make_api: MakeApi, small: Path, tmp_path: Path) -> None:
    api = make_api(max_queued_points=5000)
    for expected in (202, 503):
        assert api.post("/denoise", files={"file": small.read_bytes()}).status_code == expected
    assert len(list((tmp_path / "data" / "jobs").iterdir())) == 1
    assert list((tmp_path / "data" / "scratch").iterdir()) == []
