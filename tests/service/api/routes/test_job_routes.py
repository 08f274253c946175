"""Routes beside those of the result: removing, cancelling, lists, probes, limits."""

from __future__ import annotations

import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import httpx

from pcdnf.denoiser import Denoiser
from tests.support.service_process import Service, write_sphere


def test_deleting_a_finished_job(running: Service, small: Path) -> None:
    job = running.wait_status(running.submit(small)["id"], "succeeded")
    folder = running.data / "jobs" / job["id"]
    deadline = time.monotonic() + 20
    while (folder / "tiles").exists() or list(folder.glob("iteration-*")) or list(folder.glob("raw-*")):
        assert time.monotonic() < deadline  # they go right after the job has succeeded
        time.sleep(0.02)
    kept = sorted(re.sub("-[0-9a-f]{8}", "", path.name) for path in folder.iterdir())
    assert kept == ["display.glb", "result.npz", "result.ply", "upload"]
    assert running.client.delete(f"/jobs/{job['id']}").status_code == 204
    assert not folder.exists()
    for path in (f"/jobs/{job['id']}", f"/jobs/{job['id']}/result", f"/jobs/{job['id']}/display"):
        response = running.client.get(path)
        assert (response.status_code, response.json()["code"]) == (404, "job_not_found")


def test_cancelling_a_queued_and_a_running_job(running: Service, tmp_path: Path) -> None:
    path = write_sphere(tmp_path / "large.ply", 210_000)  # of a lane with one job in hand
    live, queued = running.submit(path), running.submit(path)
    running.wait_status(live["id"], "running")
    early = running.client.get(f"/jobs/{live['id']}/result")
    assert (early.status_code, early.json()["code"]) == (409, "job_not_finished")
    assert "retry-after" in early.headers
    response = running.client.delete(f"/jobs/{queued['id']}")
    assert (response.status_code, response.json()["status"]) == (200, "cancelled")
    response = running.client.delete(f"/jobs/{live['id']}")
    assert (response.status_code, response.json()["status"]) == (202, "cancelling")
    ended = running.wait_status(live["id"], "cancelled", "succeeded", seconds=15)
    assert ended["status"] == "cancelled"
    assert ended["progress"]["done"] < 210_000
    for job in (live, queued):
        gone = running.client.get(f"/jobs/{job['id']}/result")
        assert (gone.status_code, gone.json()["code"]) == (410, "job_cancelled")
        assert not (running.data / "jobs" / job["id"]).exists()
        assert running.client.delete(f"/jobs/{job['id']}").status_code == 204


def test_cancelling_never_removes_a_result(running: Service, done: dict[str, Any]) -> None:
    for _ in range(2):
        response = running.client.post(f"/jobs/{done['id']}/cancel")
        assert (response.status_code, response.json()["code"]) == (409, "already_finished")
        assert "result" in response.json()["hint"]
    assert running.client.get(f"/jobs/{done['id']}/result").status_code == 200


def test_cancel_is_a_route_of_its_own(api: httpx.Client, small: Path) -> None:
    job = api.post("/denoise", files={"file": small.read_bytes()}).json()
    assert job["links"]["cancel"] == f"/jobs/{job['id']}/cancel"
    for _ in range(2):  # the second finds it cancelled
        response = api.post(job["links"]["cancel"])
        assert (response.status_code, response.json()["status"]) == (200, "cancelled")
    assert "cancel" not in response.json()["links"]
    assert api.post(f"/jobs/{'0' * 32}/cancel").json()["code"] == "job_not_found"


def test_if_match_guards_against_a_change(api: httpx.Client, small: Path) -> None:
    job = api.post("/denoise", files={"file": small.read_bytes()}).json()
    link = job["links"]["self"]
    before = api.get(link).headers["etag"]
    stale = {"If-Match": '"another"'}
    for response in (api.delete(link, headers=stale), api.post(f"{link}/cancel", headers=stale)):
        assert (response.status_code, response.json()["code"]) == (412, "precondition_failed")
    assert api.get(link).json()["status"] == "queued"
    assert api.post(f"{link}/cancel", headers={"If-Match": f'"another", {before}'}).status_code == 200
    assert api.delete(link, headers={"If-Match": before}).status_code == 412, "it was of the queued job"
    assert api.delete(link, headers={"If-Match": "*"}).status_code == 204


def test_models(running: Service) -> None:
    models = {model["name"]: model for model in running.client.get("/models").json()}
    assert models["pcdnf-lite"]["default"] is True
    info = Denoiser.load("pcdnf-lite", device="cpu").info
    assert info is not None
    for name in ("kind", "licence", "version", "sha256", "recipe", "training"):
        assert models["pcdnf-lite"][name] == getattr(info, name)


def test_probes(running: Service) -> None:
    assert running.client.get("/livez").json() == {"status": "alive"}
    ready = running.client.get("/readyz").json()
    assert ready["status"] == "ready"
    assert ready["workers"][0]["state"] == "ready"
    assert ready["workers"][0]["device_requested"] == "auto"
    assert ready["workers"][0]["model"] == "pcdnf-lite"
    assert ready["free_bytes"] > 0


def test_never_ready_without_a_worker(api: httpx.Client) -> None:
    response = api.get("/readyz")
    assert (response.status_code, response.json()["code"]) == (503, "not_ready")
    assert response.json()["detail"] == "No worker is running."
    assert api.get("/livez").status_code == 200


def test_expired(make_api: Any, small: Path) -> None:
    api = make_api(job_ttl=0.01)
    job = api.post("/denoise", files={"file": small.read_bytes()}).json()
    assert api.delete(f"/jobs/{job['id']}").status_code == 200
    time.sleep(0.05)
    for path in (f"/jobs/{job['id']}", f"/jobs/{job['id']}/result", f"/jobs/{job['id']}/display"):
        response = api.get(path)
        assert (response.status_code, response.json()["code"]) == (410, "job_expired")


def test_too_many_at_a_time(make_api: Any) -> None:
    api = make_api(max_requests=1)
    body = iter([b"ply\n"])

    def slow() -> Any:
        yield from body
        busy = api.get("/jobs")
        assert (busy.status_code, busy.json()["code"]) == (503, "too_busy")
        assert busy.headers["retry-after"]
        assert api.get("/livez").status_code == 200

    api.post("/denoise", content=slow(), headers={"Content-Type": "application/ply"})
    assert api.get("/jobs").status_code == 200


def test_the_api_process_has_neither_torch_nor_readers() -> None:
    code = (
        "import sys, service.api.server, service.api.schemas;"
        "service.api.server.create_app(); service.api.schemas.shipped();"
        "print({'torch', 'numba', 'scipy', 'pcdnf.formats', 'pcdnf.denoiser'} & set(sys.modules))"
    )
    output = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert output.strip() == "set()"


def test_the_running_api_has_no_torch(running: Service, done: dict[str, Any]) -> None:
    assert done["status"] == "succeeded"
    maps = Path(f"/proc/{running.child('service.api')}/maps").read_text()
    assert "libtorch" not in maps
    assert "libtorch" in Path(f"/proc/{running.child('service.worker')}/maps").read_text()
