"""The description of the API."""

from __future__ import annotations

import httpx

from service.api.error_handlers import ProblemDetail
from service.api.schemas import EXAMPLE, JobView
from tests.support.openapi import pointed

EVERYWHERE = {
    "headers_too_slow", "headers_too_large", "cross_site", "internal_error", "too_busy", "database_unavailable",
    "database_corrupt", "data_read_only",
}  # fmt: skip
CALLER = {"not_authenticated", "too_many_requests"}
JOB = CALLER | {"invalid_parameters", "job_not_found", "job_expired"}
BATCH = CALLER | {"invalid_parameters", "batch_not_found"}
FILES = JOB | {"job_not_finished", "job_failed", "job_cancelled", "storage_unavailable"}
MODEL = CALLER | {"invalid_parameters", "model_not_found"}
ERRORS = {
    ("post", "/denoise"): CALLER | {
        "bad_request", "upload_too_slow", "idempotency_key_in_use", "job_expired", "upload_too_large",
        "file_too_large", "too_many_points", "too_much_work", "unsupported_media_type", "unsupported_encoding",
        "unknown_format", "missing_extra", "invalid_parameters", "invalid_upload", "idempotency_key_reused",
        "empty_upload", "normals_missing", "not_enough_memory", "took_too_long", "quota_exceeded", "queue_full",
        "disk_full", "draining", "stopping", "storage_unavailable",
    },
    ("get", "/jobs"): CALLER | {"invalid_parameters"},
    ("get", "/batches/{batch_id}"): BATCH,
    ("get", "/batches/{batch_id}/results"): BATCH | {"job_not_finished", "job_expired", "storage_unavailable"},
    ("get", "/jobs/{job_id}"): JOB,
    ("delete", "/jobs/{job_id}"): JOB | {"precondition_failed", "storage_unavailable"},
    ("post", "/jobs/{job_id}/cancel"): JOB | {"already_finished", "precondition_failed"},
    ("get", "/jobs/{job_id}/events"): JOB,
    ("get", "/jobs/{job_id}/result"): FILES | {
        "not_acceptable", "range_not_satisfiable", "not_enough_memory", "took_too_long", "disk_full",
    },
    ("get", "/jobs/{job_id}/display"): FILES | {"display_not_found"},
    ("get", "/models"): CALLER,
    ("get", "/livez"): set(),
    ("get", "/readyz"): {"not_ready"},
    ("get", "/metrics"): CALLER | {"invalid_parameters"},
    ("get", "/v2"): CALLER,
    ("get", "/v2/health/live"): set(),
    ("get", "/v2/health/ready"): {"not_ready"},
    ("get", "/v2/models/{model}"): MODEL,
    ("get", "/v2/models/{model}/ready"): MODEL | {"not_ready"},
}  # fmt: skip


def test_openapi_shows_every_route_and_error(api: httpx.Client) -> None:
    document = api.get("/openapi.json").json()
    assert document["openapi"].startswith("3.1")
    assert set(document["paths"]) == {"/denoise", "/jobs", "/jobs/{job_id}", "/jobs/{job_id}/result",
                                      "/jobs/{job_id}/events", "/jobs/{job_id}/display", "/jobs/{job_id}/cancel",
                                      "/models", "/batches/{batch_id}", "/batches/{batch_id}/results",
                                      "/livez", "/readyz", "/metrics", "/v2", "/v2/health/live", "/v2/health/ready",
                                      "/v2/models/{model}", "/v2/models/{model}/ready"}  # fmt: skip
    found = {}
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            codes = set()
            for status, body in operation["responses"].items():
                if status[0] not in "45":
                    continue
                ((media_type, content),) = pointed(document, body)["content"].items()
                assert media_type == "application/problem+json"
                assert content["schema"] == {"$ref": "#/components/schemas/ProblemDetail"}
                for code, reference in content["examples"].items():
                    example = pointed(document, reference)
                    assert (example["value"]["code"], str(example["value"]["status"])) == (code, status)
                    ProblemDetail.model_validate(example["value"])
                codes |= set(content["examples"])
            assert codes >= EVERYWHERE, path
            found[method, path] = codes - EVERYWHERE
    assert found == ERRORS
    (job,) = document["components"]["schemas"]["JobView"]["examples"]
    assert job == {name: value for name, value in EXAMPLE.items() if value is not None}  # as FastAPI shows it
    assert set(JobView.model_validate(EXAMPLE).model_dump()) == set(EXAMPLE)
    assert "multipart/form-data" in document["paths"]["/denoise"]["post"]["requestBody"]["content"]


def test_openapi_shows_no_regular_expression(api: httpx.Client) -> None:
    assert '"pattern"' not in api.get("/openapi.json").text


def test_openapi_says_each_thing_once(api: httpx.Client) -> None:
    response = api.get("/openapi.json")
    assert len(response.content) < 60_000
    document = response.json()
    denoise = document["paths"]["/denoise"]["post"]
    form = denoise["requestBody"]["content"]["multipart/form-data"]["schema"]["properties"]
    assert set(form) == {"file"}
    assert "iterations" in [parameter["name"] for parameter in denoise["parameters"]]
    assert response.text.count("What this code means") == 1
    assert (
        "application/octet-stream" in document["paths"]["/jobs/{job_id}/result"]["get"]["responses"]["200"]["content"]
    )
