from __future__ import annotations

from pathlib import Path

import httpx
import pytest

from tests.support.board import MakeApi


def _post(api: httpx.Client, small: Path, **headers: str) -> httpx.Response:
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    return api.post("/denoise", files={"file": small.read_bytes()}, headers=named)


def _own(api: httpx.Client) -> str:
    return f"http://127.0.0.1:{api.base_url.port}"


@pytest.mark.parametrize(
    "headers",
    [
        {"Sec_Fetch_Site": "cross-site", "Origin": "https://example.org"},
        {"Sec_Fetch_Site": "same-site", "Origin": "http://localhost:3000"},
        {"Sec_Fetch_Site": "cross-site"},
        {"Origin": "https://example.org"},
        {"Origin": "http://127.0.0.1:1"},
        {"Origin": "null"},
        {"Origin": ""},
    ],
)
def test_a_form_of_another_site_makes_no_job(api: httpx.Client, small: Path, headers: dict[str, str]) -> None:
    before = api.get("/jobs", params={"limit": 100}).json()
    response = _post(api, small, **headers)
    assert (response.status_code, response.json()["code"]) == (403, "cross_site")
    assert response.headers["content-type"] == "application/problem+json"
    assert "access-control-allow-origin" not in response.headers
    assert api.get("/jobs", params={"limit": 100}).json() == before


def test_nor_deletes_one(api: httpx.Client, small: Path) -> None:
    link = _post(api, small).headers["location"]
    assert api.delete(link, headers={"Origin": "https://example.org"}).status_code == 403
    assert api.get(link).json()["status"] == "queued"
    assert api.get(link, headers={"Sec-Fetch-Site": "cross-site"}).status_code == 200  # a link may lead here
    assert api.delete(link, headers={"Origin": _own(api)}).status_code == 200


def test_the_own_page_and_programs_may(api: httpx.Client, small: Path) -> None:
    for headers in (
        {"Sec_Fetch_Site": "same-origin", "Origin": "https://clouds.example.org"},  # behind a proxy with another name
        {"Sec_Fetch_Site": "none"},
        {"Origin": _own(api)},
        {},
    ):
        assert _post(api, small, **headers).status_code == 202, headers


@pytest.mark.parametrize("host", ["localhost:8000", "127.0.0.1", "[::1]:80", "pcdnf.localhost:8000"])
def test_names_of_this_machine(api: httpx.Client, host: str) -> None:
    assert api.get("/jobs", headers={"Host": host}).status_code == 200


@pytest.mark.parametrize("host", ["rebound.example.org:8000", "192.0.2.1", "localhost.example.org", "[::1", ""])
def test_another_name_that_points_here(api: httpx.Client, small: Path, host: str) -> None:
    for response in (api.get("/jobs", headers={"Host": host}), _post(api, small, Host=host)):
        assert (response.status_code, response.json()["code"]) == (403, "cross_site")


def test_names_do_not_matter_behind_a_key_or_a_proxy(make_api: MakeApi, small: Path) -> None:
    key = "correct horse battery"
    for settings in ({"api_key": key}, {"allow_anonymous": True}):
        api = make_api(**settings)
        api.headers["Authorization"] = f"Bearer {key}"
        assert _post(api, small, Host="clouds.example.org", Origin="https://clouds.example.org").status_code == 202
        assert _post(api, small, Host="clouds.example.org", Origin="https://example.org").status_code == 403
