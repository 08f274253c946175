"""A client that `openapi-python-client` generates from the document can do all that the API offers."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from types import ModuleType
from typing import Any

import httpx
import pytest

from pcdnf.formats import read
from tests.support.openapi import pointed
from tests.support.service_process import Service

LONGEST_DOCUMENT = 60_000
NAME = "generated_pcdnf"


@pytest.fixture(scope="module")
def document(running: Service) -> dict[str, Any]:
    """The OpenAPI document, as it is served."""
    response = running.client.get("/openapi.json")
    assert len(response.content) < LONGEST_DOCUMENT
    found: dict[str, Any] = response.json()
    return found


@pytest.fixture(scope="module")
def generated(document: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> Iterator[ModuleType]:
    """The generated package."""
    folder = tmp_path_factory.mktemp("generated")
    (folder / "openapi.json").write_text(json.dumps(document))
    (folder / "config.yml").write_text("post_hooks: []\n")
    command = [sys.executable, "-m", "openapi_python_client", "generate", "--meta", "none"]
    command += ["--path", "openapi.json", "--output-path", NAME, "--config", "config.yml"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stdout + done.stderr
    sys.path.insert(0, str(folder))
    try:
        yield importlib.import_module(NAME)
    finally:
        sys.path.remove(str(folder))


@pytest.fixture
def client(generated: ModuleType, running: Service) -> Iterator[Any]:
    """A generated client of the running service."""
    with generated.Client(base_url=str(running.client.base_url)) as client:
        yield client


def part(name: str) -> Any:
    """A module of the generated package."""
    return importlib.import_module(f"{NAME}.{name}")


def test_it_submits_polls_and_fetches(client: Any, small: Path, tmp_path: Path) -> None:
    file = part("types").File(payload=BytesIO(small.read_bytes()), file_name="scan.ply")
    body = part("models").DenoiseFilesBody(file=file)
    job = part("api.jobs.denoise").sync(client=client, body=body, iterations=1, seed=5)
    assert job.parameters["seed"] == 5
    assert job.upload["name"] == "scan"
    deadline = time.monotonic() + 120
    while job.status not in ("succeeded", "failed", "cancelled"):
        assert time.monotonic() < deadline
        time.sleep(0.1)
        job = part("api.jobs.status").sync(job.id, client=client)
    assert job.status == "succeeded"
    result = part("api.jobs.result").sync(job.id, client=client, format_="ply")
    (tmp_path / "result.ply").write_bytes(result.payload.read())
    assert len(read(tmp_path / "result.ply")) == 2000
    display = part("api.jobs.display").sync(job.id, client=client)
    assert display.payload.read(4) == b"glTF"
    finished = part("api.jobs.cancel").sync(job.id, client=client)
    assert (finished.status, finished.code) == (409, "already_finished")
    listed = part("api.jobs.jobs").sync(client=client)
    assert job.id in [one.id for one in listed]
    assert part("api.jobs.delete").sync_detailed(job.id, client=client).status_code == 204
    gone = part("api.jobs.status").sync(job.id, client=client)
    assert (gone.status, gone.code, bool(gone.hint)) == (404, "job_not_found", True)


def test_it_sends_a_file_as_the_body(client: Any, small: Path) -> None:
    file = part("types").File(payload=BytesIO(small.read_bytes()))
    job = part("api.jobs.denoise").sync(client=client, body=file, iterations=1)
    assert job.upload["points"] == 2000
    part("api.jobs.cancel").sync_detailed(job.id, client=client)


@pytest.mark.parametrize(
    ("content", "query", "code"),
    [
        (b"", {}, "empty_upload"),
        (b"neither of them", {}, "unknown_format"),
        (b"ply\nend_header\n", {}, "bad_header"),
        (b"ply\n", {"iterations": 1000}, "invalid_parameters"),
        (b"ply\n", {"model": "none"}, "invalid_parameters"),
    ],
)
def test_it_understands_refusals(client: Any, content: bytes, query: dict[str, Any], code: str) -> None:
    body = part("models").DenoiseFilesBody(file=part("types").File(payload=BytesIO(content), file_name="a.ply"))
    problem = part("api.jobs.denoise").sync(client=client, body=body, **query)
    assert problem.code == code
    assert problem.detail
    assert problem.hint


def test_it_parses_every_documented_problem(generated: ModuleType, document: dict[str, Any]) -> None:
    seen = set()
    for path, operations in document["paths"].items():
        for operation in operations.values():
            module = operation["tags"][0].replace(" ", "_")
            call = importlib.import_module(f"{NAME}.api.{module}.{operation['operationId']}")
            needed = ["0" * 32] * path.count("{")
            for status, response in operation["responses"].items():
                if status < "400":
                    continue
                media = pointed(document, response)["content"]["application/problem+json"]
                for example in media["examples"].values():
                    value = pointed(document, example)["value"]
                    answer = httpx.Response(int(status), json=value)
                    transport = httpx.MockTransport(lambda _, answer=answer: answer)  # type: ignore[misc]
                    with httpx.Client(base_url="http://service", transport=transport) as connection:
                        client = generated.Client(base_url="http://service").set_httpx_client(connection)
                        problem = call.sync_detailed(*needed, client=client).parsed
                    assert (problem.code, problem.status) == (value["code"], int(status)), (path, status)
                    seen.add(problem.code)
    assert len(seen) > 40
