from __future__ import annotations

from pathlib import Path

import pytest

from service.api.rate_limit import Rates
from service.problems import Problem
from tests.support.board import MakeApi


def test_a_bucket_a_caller(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 1000.0
    monkeypatch.setattr("service.api.rate_limit.time.monotonic", lambda: now)
    rates = Rates(6)
    for _ in range(6):
        rates.take("ada")
    with pytest.raises(Problem) as caught:
        rates.take("ada")
    assert (caught.value.code, caught.value.status, caught.value.members["limit"]) == ("too_many_requests", 429, 6)
    assert caught.value.headers == {"Retry-After": "10"}
    rates.take("bob")
    now += 10
    rates.take("ada")
    with pytest.raises(Problem):
        rates.take("ada")
    now += 3600
    for _ in range(6):  # no more than a minute's worth is saved up
        rates.take("ada")
    with pytest.raises(Problem):
        rates.take("ada")


def test_no_limit() -> None:
    rates = Rates(0)
    for _ in range(1000):
        rates.take("ada")


def test_over_http(make_api: MakeApi, small: Path) -> None:
    api = make_api(caller_requests_per_minute=2)
    assert [api.get("/jobs").status_code for _ in range(3)] == [200, 200, 429]
    refused = api.post("/denoise", files={"file": small.read_bytes()})
    assert (refused.status_code, refused.json()["code"]) == (429, "too_many_requests")
    assert 1 <= int(refused.headers["retry-after"]) <= 30
    assert api.get("/livez").status_code == 200
