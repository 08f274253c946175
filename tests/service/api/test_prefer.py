from __future__ import annotations

import time
from pathlib import Path

import httpx
import pytest
from starlette.requests import Request

from service.api.watch import preferred_wait
from tests.support.board import MakeApi
from tests.support.service_process import Service


@pytest.mark.parametrize(
    ("headers", "seconds"),
    [
        ([], None),
        (["wait=5"], 5),
        (['wait="5"'], 5),
        (["respond-async, Wait = 7; strict=x"], 7),
        (["return=minimal", "wait=3"], 3),
        (["wait=1, wait=9"], 1),
        (["wait=0"], 0),
        (["wait=100"], 60),
        (["wait=99999999999999999999"], None),
        (["wait=-1"], None),
        (["wait=x"], None),
        (["wait"], None),
        (["waiting=5"], None),
    ],
)
def test_header(headers: list[str], seconds: int | None) -> None:
    scope = {"type": "http", "headers": [(b"prefer", header.encode()) for header in headers]}
    assert preferred_wait(Request(scope), 60) == seconds


def _post(client: httpx.Client, path: Path, wait: int) -> httpx.Response:
    return client.post("/denoise", files={"file": path.read_bytes()}, headers={"Prefer": f"wait={wait}"})


def test_the_finished_job_in_one_request(running: Service, small: Path) -> None:
    response = _post(running.client, small, wait=28)
    assert (response.status_code, response.json()["status"]) == (200, "succeeded")
    assert response.headers["preference-applied"] == "wait=28"
    assert response.headers["location"] == f"/jobs/{response.json()['id']}"
    assert "retry-after" not in response.headers
    assert running.client.get(response.json()["links"]["result"]).status_code == 200


def test_a_job_that_takes_longer(make_api: MakeApi, small: Path) -> None:
    api = make_api(max_wait_seconds=1)
    began = time.monotonic()
    response = _post(api, small, wait=20)
    assert 1 <= time.monotonic() - began < 10
    assert (response.status_code, response.json()["status"]) == (202, "queued")
    assert response.headers["preference-applied"] == "wait=1"
    assert response.headers["retry-after"]


def test_too_many_wait(make_api: MakeApi, small: Path) -> None:
    response = _post(make_api(max_streams=0), small, wait=20)
    assert response.status_code == 202
    assert "preference-applied" not in response.headers


def test_without_the_header_the_answer_is_202(running: Service, small: Path) -> None:
    key = {"Idempotency-Key": "prefer"}
    first = running.client.post("/denoise", files={"file": small.read_bytes()}, headers=key | {"Prefer": "wait=28"})
    again = running.client.post("/denoise", files={"file": small.read_bytes()}, headers=key)
    assert (first.status_code, again.status_code) == (200, 202)
    assert first.json() == again.json()
