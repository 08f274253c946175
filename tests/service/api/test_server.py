"""The end of the API, as callers see it."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from service.supervision import EX_CONFIG
from tests.support.service_process import Service, write_sphere


def test_a_stopping_service_says_so_until_the_tile_is_finished(tmp_path: Path, small: Path) -> None:
    service = Service(tmp_path, tile_points=20_000, grace_seconds=60).start()
    job = service.submit(write_sphere(tmp_path / "large.ply", 20_000))  # a tile of some seconds
    service.wait_done(job["id"], 1)
    process, client = service.process, service.client
    assert process is not None
    process.send_signal(signal.SIGTERM)
    time.sleep(0.1)
    ready = client.get("/readyz")
    assert (ready.status_code, ready.json()["code"]) == (503, "not_ready")
    assert ready.json()["detail"].startswith("The service is stopping.")
    refused = client.post("/denoise", files={"file": small.read_bytes()})
    assert (refused.status_code, refused.json()["code"]) == (503, "stopping")
    assert int(refused.headers["retry-after"]) > 0
    assert service.job(job["id"])["status"] == "running"
    assert process.wait(60) == 0, service.output()
    with pytest.raises(httpx.ConnectError):
        client.get("/livez")
    service.process = None
    assert "tile 0-20000 done" in service.output()


@pytest.mark.parametrize("module", ["service.api", "service.worker", "service"])
def test_a_storage_that_cannot_be_is_refused_with_a_sentence(tmp_path: Path, module: str) -> None:
    service = Service(tmp_path, storage_url="file:///proc/nope", port=0)
    ended = subprocess.run(
        [sys.executable, "-m", module], env=service.environment, capture_output=True, text=True, timeout=120
    )
    assert ended.returncode == EX_CONFIG
    assert "pcdnf: file:///proc/nope cannot be used as storage" in ended.stderr
    assert "Traceback" not in ended.stderr


@pytest.mark.parametrize("module", ["service.api", "service.worker", "service"])
def test_a_data_folder_that_cannot_be_is_refused_with_a_sentence(tmp_path: Path, module: str) -> None:
    (tmp_path / "file").touch()
    environment = Service(tmp_path, port=0).environment | {"PCDNF_DATA_DIR": str(tmp_path / "file" / "data")}
    ended = subprocess.run([sys.executable, "-m", module], env=environment, capture_output=True, text=True, timeout=120)
    assert ended.returncode == EX_CONFIG
    assert ended.stderr.splitlines()[-1] == (
        f"pcdnf: The data folder {tmp_path}/file/data cannot be created: Not a directory. "
        "Set PCDNF_DATA_DIR to another folder."
    )


def test_an_upload_in_hand_is_taken_before_the_api_ends(tmp_path: Path, small: Path) -> None:
    service = Service(tmp_path, grace_seconds=20)
    environment = service.environment
    with subprocess.Popen(
        [sys.executable, "-c", _ALONE], env=environment, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        address = process.stdout.readline().strip()
        client = httpx.Client(base_url=address, trust_env=False, timeout=30)
        while True:
            try:
                assert client.get("/livez").status_code == 200
                break
            except httpx.TransportError:
                time.sleep(0.05)
        halfway, stopped = threading.Event(), threading.Event()
        content = small.read_bytes()

        def body() -> Iterator[bytes]:
            yield content[:100]
            halfway.set()
            stopped.wait(20)
            yield content[100:]

        answers: list[Any] = []
        headers = {"Content-Type": "application/ply"}
        upload = threading.Thread(
            target=lambda: answers.append(client.post("/denoise", content=body(), headers=headers))
        )
        upload.start()
        assert halfway.wait(20)
        time.sleep(1)  # until the request is in hand, on a busy machine too
        process.send_signal(signal.SIGTERM)
        time.sleep(0.3)
        with httpx.Client(base_url=address, trust_env=False) as other:
            assert other.get("/readyz").status_code == 503
            assert other.post("/denoise", content=content, headers=headers).json()["code"] == "stopping"
        stopped.set()
        upload.join()
        assert answers[0].status_code == 202
        began = time.monotonic()
        assert process.wait(20) == 0
        assert time.monotonic() - began < 5  # nobody else to wait for
        client.close()


_ALONE = """
import socket, os, runpy
listener = socket.create_server(("127.0.0.1", 0))
print(f"http://127.0.0.1:{listener.getsockname()[1]}", flush=True)
os.environ["PCDNF_SOCKET_FD"] = str(listener.detach())
runpy.run_module("service.api", run_name="__main__")
"""
