from __future__ import annotations

from typing import Any

import httpx
import pytest

from tests.support.service_process import Service


def test_open_inference_protocol(running: Service) -> None:
    client = running.client
    assert client.get("/v2/health/live").json() == {"live": True}
    assert client.get("/v2/health/ready").json() == {"ready": True}
    assert client.get("/v2").json()["name"] == "pcdnf"
    shipped = {model["name"]: model for model in client.get("/models").json()}
    for name, facts in shipped.items():
        model = client.get(f"/v2/models/{name}").json()
        assert model["name"] == name
        assert model["versions"] == [facts["sha256"]]
        assert model["platform"]
        for tensor in model["inputs"] + model["outputs"]:
            assert set(tensor) == {"name", "datatype", "shape"}
        assert client.get(f"/v2/models/{name}/ready").json() == {"ready": True}
    for path in ("/v2/models/nothing", "/v2/models/nothing/ready"):
        response = client.get(path)
        assert (response.status_code, response.json()["code"]) == (404, "model_not_found")
        assert "pcdnf-lite" in response.json()["hint"]
    assert client.post("/v2/models/pcdnf-lite/infer", json={}).status_code == 404


@pytest.mark.parametrize("path", ["/v2/health/ready", "/v2/models/pcdnf-lite/ready"])
def test_not_ready_without_a_worker(api: httpx.Client, path: str) -> None:
    response = api.get(path)
    assert (response.status_code, response.json()["code"]) == (503, "not_ready")
    assert api.get("/v2/health/live").status_code == 200


def test_health_needs_no_key_and_models_do(make_api: Any) -> None:
    api = make_api(api_key="k" * 16)
    assert api.get("/v2/health/live").status_code == 200
    assert api.get("/v2/health/ready").status_code == 503
    for path in ("/v2", "/v2/models/pcdnf-lite", "/v2/models/pcdnf-lite/ready"):
        assert api.get(path).status_code == 401
