from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import httpx
from prometheus_client.parser import text_string_to_metric_families

from service.api.metrics import ApiMetrics, Deployment
from service.database.tables import jobs as table
from service.jobs import drain_switch
from service.worker.metrics import STAGES, WorkerMetrics
from tests.support.board import Board
from tests.support.service_process import Served, Service

LABELS = {
    "method", "route", "status", "stage", "le", "version", "python", "outcome", "code", "worker", "state", "device",
    "precision", "model",
}  # fmt: skip


def samples(page: str) -> dict[str, float]:
    """Return every sample of a page by name and labels."""
    return {
        f"{sample.name}{sorted(sample.labels.items()) or ''}": sample.value
        for family in text_string_to_metric_families(page)
        for sample in family.samples
    }


def value(page: str, name: str, **labels: str) -> float:
    return samples(page)[f"{name}{sorted(labels.items()) or ''}"]


def test_the_page_of_a_running_service(running: Service, small: Path) -> None:
    job = running.submit(small)
    running.wait_status(job["id"], "succeeded")

    def tiles() -> float | None:
        page = running.client.get("/metrics").text
        found = value(page, "pcdnf_stage_duration_seconds_count", stage="result", worker="worker-0")
        return found or None

    running._until(tiles, "a sign of life that tells of the job")
    response = running.client.get("/metrics")
    assert response.headers["content-type"].startswith("text/plain; version=")
    page = response.text
    for stage in STAGES:
        assert value(page, "pcdnf_stage_duration_seconds_count", stage=stage, worker="worker-0") >= 1
        assert value(page, "pcdnf_stage_duration_seconds_sum", stage=stage, worker="worker-0") > 0
    assert value(page, "pcdnf_jobs_finished_total", outcome="succeeded", code="") >= 1
    assert value(page, "pcdnf_points_processed_total", worker="worker-0", model="pcdnf-lite", device="cpu") >= 2000
    assert value(page, "pcdnf_batch_patches", worker="worker-0", model="pcdnf-lite", device="cpu") >= 8
    assert value(page, "pcdnf_queue_wait_seconds_count", worker="worker-0") >= 1
    assert value(page, "pcdnf_device_memory_used_bytes", worker="worker-0", device="cpu") > 100e6
    assert value(page, "pcdnf_workers", state="ready") == 1
    assert value(page, "pcdnf_worker_cpu_fallback", worker="worker-0") == 1
    assert value(page, "pcdnf_submission_stage_duration_seconds_count", stage="check") >= 1
    assert value(page, "pcdnf_database_up") == 1
    assert value(page, "pcdnf_disk_free_bytes") > 0
    assert re.search(r'pcdnf_build_info\{python="[\d.]+",version="[\d.]+"\} 1\.0', page)
    assert job["id"] not in page
    assert "small" not in page


def test_names_and_labels_keep_to_prometheus_rules(running: Service) -> None:
    for family in text_string_to_metric_families(running.client.get("/metrics").text):
        assert family.name.startswith("pcdnf_")
        assert not re.search(r"_(milliseconds|ms|kb|mb|minutes|percent)\b", family.name)
        assert family.documentation
        for sample in family.samples:
            assert set(sample.labels) <= LABELS
            if family.type == "counter":
                assert sample.name.endswith("_total")


def test_the_queue(make_served: Any, board: Board) -> None:
    running, queued = board.submit(points=100, iterations=2, size=7), board.submit(points=30)
    board.attempts.acquire(running.id)
    board.attempts.report(running.id, done=60, points_per_second=1.0)
    with board.engine.begin() as connection:
        connection.execute(table.update().where(table.c.id == queued.id).values(created_at=table.c.created_at - 90_000))
        drain_switch.set_switch(connection, drain_switch.DRAIN, on=True)
    page = make_served(max_queued_points=999, disk_budget_bytes=10**9).client.get("/metrics").text
    assert value(page, "pcdnf_unfinished_jobs", status="queued") == 1
    assert value(page, "pcdnf_unfinished_points", status="queued") == 30
    assert value(page, "pcdnf_unfinished_points", status="running") == 140
    assert value(page, "pcdnf_unfinished_upload_bytes", status="running") == 7
    assert 90 <= value(page, "pcdnf_oldest_queued_job_age_seconds") < 120
    assert value(page, "pcdnf_queue_limit_points") == 999
    assert value(page, "pcdnf_disk_budget_bytes") == 1e9
    assert value(page, "pcdnf_disk_used_bytes") == 12  # two uploads of six bytes
    assert value(page, "pcdnf_draining") == 1


def test_every_worker_is_shown_by_every_api(make_served: Any, board: Board) -> None:
    for name, points in (("a", 10), ("b", 32)):
        measures = WorkerMetrics()
        measures.tile("pcdnf-lite", "cpu", points, 256, 0.5)
        details = {
            "device": "cpu",
            "precision": "float32",
            "model": "pcdnf-lite",
            "version": "1",
            "cpu_fallback": False,
        }
        board.workers.beat(name, pid=1, state="ready", details=details, metrics=measures.text("cpu"))
    board.workers.beat("c", pid=1, state="starting", details={})
    pages = [served.client.get("/metrics").text for served in (make_served(), make_served())]
    for page in pages:
        assert value(page, "pcdnf_workers", state="ready") == 2
        assert value(page, "pcdnf_workers", state="starting") == 1
        labels = {"model": "pcdnf-lite", "device": "cpu"}
        assert [value(page, "pcdnf_points_processed_total", worker=name, **labels) for name in "ab"] == [10, 32]
        assert value(page, "pcdnf_worker_cpu_fallback", worker="a") == 0
        assert page.count("# TYPE pcdnf_points_processed_total counter") == 1
    board.workers.leave("b")
    assert 'worker="b"' not in make_served().client.get("/metrics").text


def test_without_the_database_the_rest_is_told(board: Board) -> None:
    board.engine.dispose()
    broken = board.engine.execution_options()
    deployment = Deployment(broken, board.storage, board.settings)
    database = Path(str(board.engine.url.database))
    database.rename(database.with_name("away"))
    database.mkdir()
    found = {family.name: family for family in deployment.collect()}
    assert found["pcdnf_database_up"].samples[0].value == 0
    assert found["pcdnf_disk_free_bytes"].samples[0].value > 0
    assert "pcdnf_workers" not in found


def test_asks_for_a_key_where_the_service_does(make_served: Any) -> None:
    client: httpx.Client = make_served(api_key="k" * 16).client
    refused = client.get("/metrics")
    assert (refused.status_code, refused.json()["code"]) == (401, "not_authenticated")
    assert client.get("/metrics", headers={"Authorization": f"Bearer {'k' * 16}"}).status_code == 200


def test_made_up_methods_and_paths_make_no_series(make_served: Any) -> None:
    served: Served = make_served()
    for number, method in enumerate(("PROPFIND", "MKCOL", "TRACE", "LOCK")):
        served.client.request(method, f"/made-up-{number}")
    page = served.client.get("/metrics").text
    assert value(page, "pcdnf_http_request_duration_seconds_count", method="other", route="none", status="404") == 4
    assert "made-up" not in page
    assert "PROPFIND" not in page


def test_openmetrics_for_those_who_ask(make_served: Any) -> None:
    accept = {"Accept": "application/openmetrics-text; version=1.0.0"}
    response = make_served().client.get("/metrics", headers=accept)
    assert response.headers["content-type"].startswith("application/openmetrics-text")
    assert response.text.endswith("# EOF\n")


SUFFIXES = {"histogram": ("_bucket", "_sum", "_count"), "counter": ("_total",), "info": ("_info",)}


def test_the_dashboard_asks_for_what_there_is(board: Board) -> None:
    metrics = ApiMetrics()
    metrics.registry.register(Deployment(board.engine, board.storage, board.settings))
    board.workers.beat("a", pid=1, state="ready", details={}, metrics=WorkerMetrics().text("cpu"))
    known = {
        family.name + suffix for family in metrics.registry.collect() for suffix in SUFFIXES.get(family.type, ("",))
    }
    path = Path(__file__).parents[3] / "docker" / "grafana-dashboard.json"
    panels = json.loads(path.read_text())["panels"]
    queries = [target["expr"] for panel in panels for target in panel["targets"]]
    asked = {name for query in queries for name in re.findall(r"\bpcdnf_\w+", query)}
    assert asked <= known
    assert {
        name for query in queries for group in re.findall(r"by \(([^)]*)\)", query) for name in group.split(", ")
    } <= LABELS
    page = (Path(__file__).parents[3] / "docs" / "operations.md").read_text()
    for family in metrics.registry.collect():
        assert f"`{family.name}" in page, family.name
    assert {name for name in re.findall(r"`(pcdnf_\w+)", page) if not name.endswith("_")} <= known | {
        family.name for family in metrics.registry.collect()
    }
