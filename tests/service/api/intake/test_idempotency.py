from __future__ import annotations

import hashlib
import os
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
import sqlalchemy as sa
from starlette.requests import Request

from service.api.intake import idempotency
from service.api.intake.idempotency import Claims, fingerprint, idempotency_key
from service.database.engine import exclusive
from service.jobs.attempts import Attempts
from service.problems import Problem
from tests.support.board import Board, MakeApi
from tests.support.service_process import Served, write_sphere

KEY = "0f8fad5b-d9cb-469f-a165-70867728950e"


def _post(api: httpx.Client, path: Path, key: str = KEY, **options: Any) -> httpx.Response:
    return api.post(
        "/denoise", files={"file": (path.name, path.read_bytes())}, headers={"Idempotency-Key": key}, **options
    )


def _code(response: httpx.Response) -> tuple[int, str]:
    assert response.headers["content-type"] == "application/problem+json"
    return response.status_code, response.json()["code"]


def test_the_same_request_gets_the_same_job(make_api: MakeApi, small: Path) -> None:
    api = make_api()
    first = _post(api, small, params={"seed": 3})
    again = _post(api, small, key=f'"{KEY}"', data={"seed": "3"})  # quoted as the draft has it, and as a form
    assert first.status_code == again.status_code == 202
    assert first.headers["location"] == again.headers["location"]
    assert first.json() == again.json()
    assert len(api.get("/jobs").json()) == 1
    assert _post(api, small, key="other", params={"seed": 3}).json()["id"] != first.json()["id"]


def test_another_request_is_refused(make_api: MakeApi, small: Path, tmp_path: Path) -> None:
    api = make_api()
    assert _post(api, small).status_code == 202
    refused = (422, "idempotency_key_reused")
    assert _code(_post(api, write_sphere(tmp_path / small.name, 2000, seed=1))) == refused
    assert _code(_post(api, small, params={"iterations": 1})) == refused
    os.link(small, tmp_path / "other name.ply")
    assert _code(_post(api, tmp_path / "other name.ply")) == refused
    assert len(api.get("/jobs").json()) == 1


def test_a_request_in_the_middle_of_its_upload(make_api: MakeApi, small: Path) -> None:
    api = make_api()
    headers = {"Content-Type": "application/ply", "Idempotency-Key": KEY}
    content = small.read_bytes()

    def slowly() -> Iterator[bytes]:
        yield content[:1000]
        time.sleep(1)  # until the service has begun with it
        second = api.post("/denoise", content=content, headers=headers)
        assert _code(second) == (409, "idempotency_key_in_use")
        assert int(second.headers["retry-after"]) > 0
        yield content[1000:]

    assert api.post("/denoise", content=slowly(), headers=headers).status_code == 202
    assert api.post("/denoise", content=content, headers=headers).status_code == 202
    assert len(api.get("/jobs").json()) == 1


def test_a_refused_request_frees_its_key(make_api: MakeApi, small: Path, tmp_path: Path) -> None:
    api = make_api()
    (tmp_path / "bad.ply").write_bytes(b"ply\nnot really")
    assert _post(api, tmp_path / "bad.ply").status_code == 422
    assert _post(api, small).status_code == 202


def test_keys_belong_to_their_caller(make_api: MakeApi, small: Path, tmp_path: Path) -> None:
    keys = tmp_path / "keys"
    keys.write_text("".join(f"{name}:{hashlib.sha256(name.encode()).hexdigest()}\n" for name in ("ada", "bob")))
    api = make_api(api_keys_file=keys)
    ids = set()
    for name in ("ada", "bob"):
        api.headers["Authorization"] = f"Bearer {name}"
        ids |= {_post(api, small).json()["id"] for _ in range(2)}
    assert len(ids) == 2


def test_a_key_lives_as_long_as_its_job(make_api: MakeApi, small: Path) -> None:
    api = make_api()
    job = _post(api, small).json()["id"]
    api.delete(f"/jobs/{job}")
    assert _post(api, small).json()["status"] == "cancelled"
    api.delete(f"/jobs/{job}")
    assert _post(api, small).json()["id"] != job


def test_a_request_sent_again_does_not_push_its_own_job_out(make_served: Callable[..., Served], small: Path) -> None:
    served = make_served(disk_budget_bytes=int(1.5 * small.stat().st_size))
    first = _post(served.client, small).json()["id"]
    attempts = Attempts(served.app.state.engine, 1000)
    attempts.acquire(first)
    attempts.succeed(first, {}, [])
    again = _post(served.client, small)
    assert (again.status_code, again.json()["id"], again.json()["status"]) == (202, first, "succeeded")


def test_the_key_of_an_expired_job(make_api: MakeApi, small: Path) -> None:
    api = make_api(job_ttl=0.01)
    api.delete(f"/jobs/{_post(api, small).json()['id']}")
    assert _code(_post(api, small)) == (410, "job_expired")


@pytest.mark.parametrize("key", ["", '""', "a b", "x" * 256, 'a"b'])
def test_what_is_no_key(api: httpx.Client, small: Path, key: str) -> None:
    assert _code(_post(api, small, key=key)) == (400, "bad_request")


def test_two_keys_in_one_request() -> None:
    header = (b"idempotency-key", b"a")
    assert idempotency_key(Request({"type": "http", "headers": [header]})) == "a"
    with pytest.raises(Problem):
        idempotency_key(Request({"type": "http", "headers": [header, header]}))


def test_one_claim_of_many_at_once(board: Board) -> None:
    claims = Claims(board.engine)
    won, refused = [], []

    def claim() -> None:
        try:
            won.append(claims.claim("ada", KEY))
        except Problem as problem:
            refused.append(problem.code)

    threads = [threading.Thread(target=claim) for _ in range(10)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(won) == 1
    assert refused == ["idempotency_key_in_use"] * 9


def test_a_lease_that_ran_out_is_taken_over_and_fenced(board: Board, monkeypatch: pytest.MonkeyPatch) -> None:
    claims = Claims(board.engine)
    monkeypatch.setattr(idempotency, "LEASE_SECONDS", -1.0)
    lost = claims.claim("ada", KEY)
    monkeypatch.setattr(idempotency, "LEASE_SECONDS", 60.0)
    taken = claims.claim("ada", KEY)
    claims.renew(lost)
    claims.release(lost)
    with pytest.raises(Problem) as caught:
        claims.claim("ada", KEY)
    assert caught.value.code == "idempotency_key_in_use"
    job = board.submit()
    with board.engine.begin() as connection:
        with pytest.raises(Problem) as caught:
            Claims.bind(connection, lost, job.id, "f")
        assert caught.value.code == "idempotency_key_in_use"
        Claims.bind(connection, taken, job.id, "f")
    claims.release(taken)
    assert claims.claim("ada", KEY).job == job.id


def test_what_a_transaction_read_stays_true(board: Board) -> None:
    with board.engine.connect() as connection, exclusive(connection):
        connection.execute(sa.text("SELECT 1")).all()
        with board.engine.connect() as other:
            other.exec_driver_sql("PRAGMA busy_timeout=0")
            with pytest.raises(sa.exc.OperationalError, match="locked"):
                other.exec_driver_sql("BEGIN IMMEDIATE")
            other.exec_driver_sql("PRAGMA busy_timeout=30000")


def test_fingerprint() -> None:
    first = fingerprint("aa", "scan", {"seed": 1, "iterations": 2})
    assert first == fingerprint("aa", "scan", {"iterations": 2, "seed": 1})
    assert (
        len({first, fingerprint("ab", "scan", {}), fingerprint("aa", "scam", {}), fingerprint("aa", "scan", {})}) == 4
    )
