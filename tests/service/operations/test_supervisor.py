from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from service.supervision import EX_CONFIG
from tests.support.imports import imported
from tests.support.service_process import Service

STOP_SECONDS = 6.0  # two on a machine that has nothing else to do


def _serve(tmp_path: Path, *arguments: str, **settings: str) -> subprocess.CompletedProcess[str]:
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PCDNF_")}
    environment |= {"PCDNF_DATA_DIR": str(tmp_path)} | {
        f"PCDNF_{key.upper()}": value for key, value in settings.items()
    }
    return subprocess.run(
        [sys.executable, "-m", "service", *arguments], env=environment, capture_output=True, text=True, timeout=180
    )


def test_refuses_the_network_without_a_key(tmp_path: Path) -> None:
    ended = _serve(tmp_path, "--host", "0.0.0.0")
    assert ended.returncode == EX_CONFIG
    assert "PCDNF_API_KEY" in ended.stderr
    assert "Traceback" not in ended.stderr


def test_refuses_a_port_that_is_taken(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        ended = _serve(tmp_path, "--port", str(port))
    assert ended.returncode == EX_CONFIG
    assert f"port {port}" in ended.stderr
    assert "--port" in ended.stderr


def test_refuses_a_bad_setting_by_its_name(tmp_path: Path) -> None:
    ended = _serve(tmp_path, max_points="many")
    assert ended.returncode == EX_CONFIG
    assert "PCDNF_MAX_POINTS" in ended.stderr


def test_a_child_that_refuses_ends_the_service(tmp_path: Path) -> None:
    ended = _serve(tmp_path, "--port", "0", default_model="nothing", grace_seconds="1000")  # which nobody waits for
    assert ended.returncode == EX_CONFIG
    last = ended.stderr.splitlines()[-1]
    assert last.startswith("pcdnf: ")
    assert "no model" in last
    assert ended.stderr.count("no model") == 1
    assert "starting it again" not in ended.stderr


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_stops_cleanly_even_while_starting(tmp_path: Path, number: signal.Signals) -> None:
    service = Service(tmp_path).start(ready=False)
    began = time.monotonic()
    assert service.stop(number) == 0, service.output()
    assert time.monotonic() - began < STOP_SECONDS
    assert "Traceback" not in service.output()


@pytest.mark.full
@pytest.mark.parametrize("alive", [True, False], ids=["starting again", "not started again yet"])
def test_stops_at_once_after_its_worker_was_killed(tmp_path: Path, alive: bool) -> None:
    service = Service(tmp_path, grace_seconds=300).start()
    killed = service.child("service.worker")
    os.kill(killed, signal.SIGKILL)
    if alive:
        service.wait_child("service.worker", other_than=killed)
        time.sleep(1.0)  # it loads its libraries
    else:
        deadline = time.monotonic() + 20
        while "starting it again" not in service.output():
            assert time.monotonic() < deadline
            time.sleep(0.02)
    began = time.monotonic()
    assert service.stop() == 0, service.output()
    assert time.monotonic() - began < STOP_SECONDS


def test_the_supervisor_is_small(tmp_path: Path) -> None:
    service = Service(tmp_path).start(ready=False)
    assert service.process is not None
    status = Path(f"/proc/{service.process.pid}/status").read_text()
    (resident,) = (int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS:"))
    assert resident < 25_000, f"{resident} kB"
    assert service.stop() == 0, service.output()


def test_the_supervisor_imports_no_library_of_the_service() -> None:
    assert not imported("service.operations.supervisor") & {"fastapi", "starlette", "pydantic", "sqlalchemy", "dbos"}


def test_children_do_not_outlive_the_supervisor(tmp_path: Path) -> None:
    service = Service(tmp_path).start(ready=False)
    deadline = time.monotonic() + 30
    while service.client.get("/livez").status_code != 200:
        assert time.monotonic() < deadline
    children = [service.child(module) for module in ("service.api", "service.worker")]
    service.stop(signal.SIGKILL)
    deadline = time.monotonic() + 30
    while any(Path(f"/proc/{child}/exe").exists() for child in children):
        assert time.monotonic() < deadline, service.output()
        time.sleep(0.1)
