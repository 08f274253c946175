"""``GET /jobs``: by state and name, a page at a time, with the total."""

from __future__ import annotations

import re

import httpx
import pytest

from tests.support.board import MakeApi


@pytest.fixture
def five(make_api: MakeApi, small_text: bytes) -> httpx.Client:
    """An API with five jobs, of which the first and the last were cancelled."""
    api = make_api()
    jobs = [
        api.post(f"/denoise?filename={name}.xyz", content=small_text, headers={"Content-Type": "text/plain"}).json()
        for name in ("roof", "wall", "Roof%202", "100%25", "roof_3")
    ]
    for job in (jobs[0], jobs[-1]):
        api.post(f"{job['links']['cancel']}")
    return api


@pytest.fixture
def small_text() -> bytes:
    return b"".join(b"%d %d %d\n" % (i, i * i, i % 7) for i in range(50))


def names(response: httpx.Response) -> list[str]:
    return [job["upload"]["name"] for job in response.json()]


def test_by_state_and_name(five: httpx.Client) -> None:
    assert names(five.get("/jobs?status=cancelled")) == ["roof_3", "roof"]
    assert names(five.get("/jobs?status=QUEUED&name=roof")) == ["Roof 2"]
    assert len(names(five.get("/jobs?status=queued&status=cancelled"))) == 5
    assert names(five.get("/jobs?name=_3")) == ["roof_3"]
    assert five.get("/jobs?name=roof").headers["x-total-count"] == "3"
    refused = five.get("/jobs?status=done").json()
    assert refused["code"] == "invalid_parameters"
    assert "'queued', 'running'" in refused["detail"]
    assert five.get("/jobs?limit=many").json()["detail"] == "limit: must be a whole number."


def test_pages_lead_to_the_next(five: httpx.Client) -> None:
    seen, address, pages = [], "/jobs?limit=2&name=o", 0
    while address:
        page = five.get(address)
        assert page.headers["x-total-count"] == "3"
        seen += names(page)
        pages += 1
        link = re.fullmatch(r'<(/jobs\?[^>]+)>; rel="next"', page.headers.get("link", ""))
        address = link[1] if link else ""
    assert (seen, pages) == (["roof_3", "Roof 2", "roof"], 2)
