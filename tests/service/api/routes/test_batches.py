"""Several files in one request are a batch."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import httpx
import pytest

from pcdnf.formats import read
from service.api.results.archive import PROBLEMS, archive
from service.jobs.files import job_file
from tests.support.board import Board, MakeApi
from tests.support.service_process import Service, write_sphere


def send(client: httpx.Client, *files: tuple[str, bytes], query: str = "", **headers: str) -> httpx.Response:
    return client.post(f"/denoise{query}", files=[("file", file) for file in files], headers=headers)


def test_files_become_jobs_in_their_order(api: httpx.Client, small: Path) -> None:
    content = small.read_bytes()
    names = ["b", "a", "c"]
    answer = send(api, *((f"{name}.ply", content) for name in names), query="?seed=4")
    assert answer.status_code == 201, answer.text
    batch = answer.json()
    assert answer.headers["location"] == batch["links"]["self"] == f"/batches/{batch['id']}"
    assert [job["upload"]["name"] for job in batch["jobs"]] == names
    assert {job["parameters"]["seed"] for job in batch["jobs"]} == {4}
    assert (batch["status"], batch["counts"]) == ("live", {"queued": 3})
    assert "results" not in batch["links"]
    assert {job["links"]["batch"] for job in batch["jobs"]} == {batch["links"]["self"]}
    again = api.get(batch["links"]["self"])
    assert [job["id"] for job in again.json()["jobs"]] == [job["id"] for job in batch["jobs"]]
    assert int(again.headers["retry-after"]) > 0
    early = api.get(f"{batch['links']['self']}/results")
    assert (early.status_code, early.json()["code"], early.json()["actual"]) == (409, "job_not_finished", 3)


def test_one_bad_file_refuses_all_and_is_named(make_api: MakeApi, small: Path, tmp_path: Path) -> None:
    api = make_api()
    answer = send(api, ("a.ply", small.read_bytes()), ("broken.ply", b"ply\nend_header\n"))
    assert (answer.status_code, answer.json()["code"], answer.json()["file"]) == (422, "bad_header", 2)
    assert answer.json()["detail"].startswith("File 2, broken: ")
    assert api.get("/jobs").json() == []
    assert not list((tmp_path / "data" / "jobs").iterdir())
    assert not list((tmp_path / "data" / "scratch").iterdir())


def test_all_or_none_are_queued(make_api: MakeApi, small: Path, tmp_path: Path) -> None:
    api = make_api(max_caller_jobs=2)
    content = small.read_bytes()
    answer = send(api, *((f"{name}.ply", content) for name in "abc"))
    assert (answer.status_code, answer.json()["code"]) == (429, "quota_exceeded")
    assert api.get("/jobs").json() == []
    assert not list((tmp_path / "data" / "jobs").iterdir())


def test_the_same_key_is_the_same_batch(api: httpx.Client, small: Path) -> None:
    files = [("a.ply", small.read_bytes()), ("b.ply", small.read_bytes())]
    first = send(api, *files, **{"Idempotency-Key": "batch-1"}).json()
    assert send(api, *files, **{"Idempotency-Key": "batch-1"}).json()["id"] == first["id"]
    other = send(api, files[0], **{"Idempotency-Key": "batch-1"})
    assert (other.status_code, other.json()["code"]) == (422, "idempotency_key_reused")


def test_a_batch_of_others_is_unknown(make_api: MakeApi, small: Path, tmp_path: Path) -> None:
    keys = tmp_path / "keys"
    import hashlib

    keys.write_text("".join(f"{name}:{hashlib.sha256(name.encode() * 8).hexdigest()}\n" for name in ("ada", "bob")))
    api = make_api(api_keys_file=keys)
    ada, bob = ({"Authorization": f"Bearer {name * 8}"} for name in ("ada", "bob"))
    batch = send(api, ("a.ply", small.read_bytes()), ("b.ply", small.read_bytes()), **ada).json()
    assert api.get(batch["links"]["self"], headers=ada).status_code == 200
    for address in (batch["links"]["self"], f"{batch['links']['self']}/results", "/batches/none"):
        answer = api.get(address, headers=bob)
        assert (answer.status_code, answer.json()["code"]) == (404, "batch_not_found")


def test_the_archive_holds_results_and_problems(board: Board) -> None:
    jobs = [board.submit(name=name) for name in ("a", "a", "b")]
    for number, job in enumerate(jobs[:2]):
        scratch = board.storage.scratch()
        scratch.write_bytes(b"result %d" % number)
        board.storage.put(scratch, job_file(job.id, "result.ply"))
        board.set(job.id, status="succeeded", results={"ply": {"file": "result.ply"}}, finished_at=1_700_000_000_000)
    board.set(jobs[2].id, status="failed", problem={"code": "worker_lost", "detail": "It crashed."})
    packed = zipfile.ZipFile(io.BytesIO(b"".join(archive([board.now(job) for job in jobs], board.storage))))
    assert packed.testzip() is None
    assert packed.namelist() == ["a_denoised.ply", "a_denoised_2.ply", PROBLEMS]
    assert packed.read("a_denoised_2.ply") == b"result 1"
    assert json.loads(packed.read(PROBLEMS))["b_denoised.ply"]["code"] == "worker_lost"


@pytest.mark.full
def test_the_results_of_a_batch(running: Service, tmp_path: Path) -> None:
    files = [(f"{n}.ply", write_sphere(tmp_path / f"{n}.ply", 300, seed=n).read_bytes()) for n in range(2)]
    batch: dict[str, Any] = send(running.client, *files, query="?iterations=1").json()
    for job in batch["jobs"]:
        running.wait_status(job["id"], "succeeded")
    now = running.client.get(batch["links"]["self"]).json()
    assert (now["status"], now["counts"]) == ("finished", {"succeeded": 2})
    response = running.client.get(now["links"]["results"])
    assert response.headers["content-type"] == "application/zip"
    with zipfile.ZipFile(io.BytesIO(response.content)) as packed:
        packed.extractall(tmp_path / "out")
    assert [len(read(tmp_path / "out" / f"{n}_denoised.ply")) for n in range(2)] == [300, 300]
