from __future__ import annotations

import logging
import re
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy.exc import IntegrityError

from service.api.app import create_app
from service.database.tables import jobs as table
from service.settings import Settings
from service.telemetry.logs import ATTRIBUTES, JsonFormatter
from tests.support.board import Board
from tests.support.service_process import Served

TRACE = "0af7651916cd43dd8448eb211c80319c"


def test_request_ids_are_echoed_or_made(api: httpx.Client) -> None:
    assert api.get("/jobs", headers={"X-Request-ID": "build-7:a.b_c"}).headers["x-request-id"] == "build-7:a.b_c"
    for bad in ("", "a b", 'x"y', "a" * 129, "é", "a\tb"):
        response = api.get("/nothing", headers={"X-Request-ID": bad.encode("latin1")})
        assert re.fullmatch(r"[0-9a-f]{16}", response.headers["x-request-id"]), bad
    first, second = (api.get("/livez").headers["x-request-id"] for _ in range(2))
    assert first != second


def test_server_timing_tells_the_stages(api: httpx.Client, small: Path) -> None:
    timing = api.post("/denoise", files={"file": small.read_bytes()}).headers["server-timing"]
    found = dict(re.findall(r"(\w+);dur=([\d.]+)", timing))
    assert list(found) == ["upload", "check", "store", "queue", "total"]
    milliseconds = [float(value) for value in found.values()]
    assert sum(milliseconds[:-1]) <= milliseconds[-1] + 0.5
    assert re.fullmatch(r"total;dur=[\d.]+", api.get("/livez").headers["server-timing"])


def test_a_job_carries_request_and_trace(make_served: Any, board: Board, small: Path) -> None:
    served: Served = make_served()
    headers = {"X-Request-ID": "r1", "traceparent": f"00-{TRACE}-b7ad6b7169203331-01", "tracestate": "a=1"}
    job = served.client.post("/denoise", files={"file": small.read_bytes()}, headers=headers).json()
    row = board.attempts.get(job["id"])
    assert row is not None
    assert row.context == {
        "request_id": "r1", "traceparent": f"00-{TRACE}-b7ad6b7169203331-01", "tracestate": "a=1",
    }  # fmt: skip
    assert "context" not in job
    plain = served.client.post("/denoise", files={"file": small.read_bytes()}, headers={"traceparent": "00-zz"}).json()
    row = board.attempts.get(plain["id"])
    assert row is not None
    assert list(row.context or {}) == ["request_id"]


def test_the_log_names_routes_jobs_and_ids_but_no_file_and_no_key(
    make_served: Any, small: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.DEBUG)
    served: Served = make_served(api_key="a-secret-of-sixteen")
    lines: list[str] = []

    class Kept(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            lines.append(JsonFormatter().format(record))

    kept = Kept()
    logging.getLogger().addHandler(kept)
    try:
        key = {"Authorization": "Bearer a-secret-of-sixteen", "X-Request-ID": "r7"}
        upload = {"file": ("my_private_scan.ply", small.read_bytes())}
        job = served.client.post("/denoise?seed=4", files=upload, headers=key).json()
        served.client.get(f"/jobs/{job['id']}", headers=key)
        served.client.get("/my_private_scan.ply?key=a-secret-of-sixteen", headers=key)
        served.client.get("/jobs/my_private_scan.ply", headers=key | {"Authorization": "Bearer a-secret-of-others"})
        served.client.post("/denoise", files={"file": ("my_private_scan.ply", b"nothing")}, headers=key)
    finally:
        logging.getLogger().removeHandler(kept)
    page = "\n".join(line for line in lines if '"logger": "service.' in line)
    assert "my_private_scan" not in page.replace('"job_id": "my_private_scan.ply"', "")
    assert "a-secret" not in page
    assert f'"job_id": "{job["id"]}"' in page
    routes = [getattr(record, ATTRIBUTES)["http.route"] for record in caplog.records if hasattr(record, ATTRIBUTES)]
    assert routes == ["/denoise", "/jobs/{job_id}", "none", "/jobs/{job_id}", "/denoise"]
    assert '"request_id": "r7"' in page


def test_polls_that_find_nothing_new_are_logged_at_debug(
    api: httpx.Client, small: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.DEBUG)
    job = api.post("/denoise", files={"file": small.read_bytes()}).json()
    polled = api.get(f"/jobs/{job['id']}")
    api.get(f"/jobs/{job['id']}", headers={"If-None-Match": polled.headers["etag"]})
    api.get("/jobs/none")
    api.get("/jobs")
    seen = [record for record in caplog.records if hasattr(record, ATTRIBUTES)]
    levels = {
        (facts["http.route"], facts["http.response.status_code"]): record.levelname
        for record in seen
        for facts in [getattr(record, ATTRIBUTES)]
    }
    assert levels == {
        ("/denoise", 202): "INFO",
        ("/jobs/{job_id}", 200): "DEBUG",
        ("/jobs/{job_id}", 304): "DEBUG",
        ("/jobs/{job_id}", 404): "INFO",
        ("/jobs", 200): "INFO",
    }


def test_errors_of_the_database_show_no_values(board: Board) -> None:
    job = board.submit()
    with pytest.raises(IntegrityError) as caught, board.engine.begin() as connection:
        connection.execute(table.insert().values(id=job.id, owner="my_private_scan", status="queued"))
    assert "my_private_scan" not in str(caught.value)


def test_an_error_of_the_service_keeps_its_headers(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    app = create_app(Settings(data_dir=tmp_path))

    @app.get("/bug")
    async def bug() -> None:
        raise ZeroDivisionError("a defect")

    with Served(app) as client:
        response = client.get("/bug", headers={"X-Request-ID": "r9"})
        page = client.get("/metrics").text
    assert (response.status_code, response.json()["code"]) == (500, "internal_error")
    assert "X-Request-ID" in response.json()["hint"]
    assert response.headers["x-request-id"] == "r9"
    assert response.headers["x-content-type-options"] == "nosniff"
    assert [record.exc_info[0] for record in caplog.records if record.exc_info] == [ZeroDivisionError]
    assert 'pcdnf_http_request_duration_seconds_count{method="GET",route="/bug",status="500"} 1.0' in page
