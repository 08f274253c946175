from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from service.jobs import drain_switch
from service.jobs.admission import Load
from service.problems import Problem
from tests.support.board import Board
from tests.support.service_process import Served


def _turn(board: Board, *, on: bool) -> None:
    with board.engine.begin() as connection:
        drain_switch.set_switch(connection, drain_switch.DRAIN, on=on)


def test_a_drained_service_takes_no_jobs_and_loses_none(board: Board) -> None:
    before = board.submit()
    for _ in range(2):  # on is on
        _turn(board, on=True)
    for refused in (board.submit, lambda: board.jobs.check_room("ada", Load(1, 1, 1))):
        with pytest.raises(Problem) as caught:
            refused()
        assert (caught.value.code, caught.value.status, caught.value.headers["Retry-After"]) == ("draining", 503, "60")
    assert board.jobs.status(before.id, "ada") == before
    assert board.attempts.acquire(before.id) is not None  # and it is worked off
    for _ in range(2):
        _turn(board, on=False)
    board.submit()


def test_callers_of_a_drained_service(make_served: Any, board: Board, small: Path) -> None:
    served: Served = make_served()
    body = small.read_bytes()
    key = {"Idempotency-Key": "k"}
    job = served.client.post("/denoise", files={"file": body}, headers=key).json()
    _turn(board, on=True)
    refused = served.client.post("/denoise", files={"file": body})
    assert (refused.status_code, refused.json()["code"], refused.headers["retry-after"]) == (503, "draining", "60")
    again = served.client.post("/denoise", files={"file": body}, headers=key)
    assert (again.status_code, again.json()["id"]) == (202, job["id"])
    assert served.client.get(f"/jobs/{job['id']}").status_code == 200
    ready = served.client.get("/readyz")
    assert ready.status_code == 503
    assert "draining" in ready.json()["detail"]
    assert served.client.get("/livez").status_code == 200
    _turn(board, on=False)
    assert served.client.post("/denoise", files={"file": body}).status_code == 202
