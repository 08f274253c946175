"""Pages of other sites may use the API only where the operator names them, and only with a key."""

from __future__ import annotations

from pathlib import Path

import pytest

from service.exposure import check_exposure
from service.settings import Settings, SettingsError
from tests.support.board import MakeApi

PAGE = "https://app.example.org"
KEY = "a-secret-of-sixteen"


def test_without_the_setting_there_are_no_headers(make_api: MakeApi) -> None:
    api = make_api(api_key=KEY)
    answer = api.get("/livez", headers={"Origin": PAGE})
    assert not [name for name in answer.headers if name.startswith("access-control")]
    assert api.options("/denoise", headers={"Origin": PAGE, "Access-Control-Request-Method": "POST"}).status_code == 405


def test_an_allowed_page(make_api: MakeApi, small: Path) -> None:
    api = make_api(api_key=KEY, allowed_origins=f" {PAGE}, http://localhost:3000")
    asked = {"Access-Control-Request-Method": "POST", "Access-Control-Request-Headers": "authorization,prefer"}
    preflight = api.options("/denoise", headers={"Origin": PAGE, **asked})
    assert preflight.status_code == 200
    assert preflight.headers["access-control-allow-origin"] == PAGE
    assert "POST" in preflight.headers["access-control-allow-methods"]
    assert "access-control-allow-credentials" not in preflight.headers
    page = {"Origin": PAGE, "Sec-Fetch-Site": "cross-site"}
    files = {"file": small.read_bytes()}
    answer = api.post("/denoise", files=files, headers=page | {"Authorization": f"Bearer {KEY}"})
    assert answer.status_code == 202
    assert answer.headers["access-control-allow-origin"] == PAGE
    assert "Location" in answer.headers["access-control-expose-headers"]
    refused = api.post("/denoise", files=files, headers=page)
    assert (refused.status_code, refused.json()["code"]) == (401, "not_authenticated")
    assert refused.headers["access-control-allow-origin"] == PAGE  # so that the page can read why


@pytest.mark.parametrize("origin", ["https://evil.org", "https://app.example.org.evil.org", "null"])
def test_other_pages_stay_outside(make_api: MakeApi, origin: str) -> None:
    api = make_api(api_key=KEY, allowed_origins=PAGE)
    headers = {"Origin": origin, "Access-Control-Request-Method": "POST"}
    preflight = api.options("/denoise", headers=headers)
    assert preflight.status_code == 400
    assert "access-control-allow-origin" not in preflight.headers
    answer = api.post("/denoise", headers=headers | {"Authorization": f"Bearer {KEY}"})
    assert (answer.status_code, answer.json()["code"]) == (403, "cross_site")


def test_the_setting_needs_keys_and_plain_origins(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="PCDNF_API_KEY"):
        check_exposure(Settings(data_dir=tmp_path, allowed_origins=PAGE))
    for wrong in ("*", "app.example.org", "https://app.example.org/", "https://*.example.org"):
        with pytest.raises(ValueError, match="origins such as"):
            Settings(data_dir=tmp_path, allowed_origins=wrong)


def test_callbacks_need_a_secret(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="PCDNF_CALLBACK_SECRET"):
        check_exposure(Settings(data_dir=tmp_path, callback_hosts="hooks.example.org"))
    for wrong in ("https://hooks.example.org", "localhost", "*.example.org", "10.0.0.1:80"):
        with pytest.raises(ValueError, match="host names"):
            Settings(data_dir=tmp_path, callback_hosts=wrong)
