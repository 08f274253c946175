"""What the image is built from, and the programs that go into it. Nothing is built here."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import threading
import tomllib
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from pcdnf import __version__

ROOT = Path(__file__).parents[2]
DOCKER = ROOT / "docker"
DOCKERFILE = (DOCKER / "Dockerfile").read_text()


def requirements() -> list[Requirement]:
    output = subprocess.run(
        [sys.executable, DOCKER / "requirements.py", ROOT / "pyproject.toml"],
        check=True,
        capture_output=True,
        text=True,
    )
    return [Requirement(line) for line in output.stdout.splitlines()]


def test_requirements_are_the_service_and_nothing_for_tests() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    names = {requirement.name for requirement in requirements()}
    extras = project["optional-dependencies"]
    wanted = project["dependencies"] + extras["denoise"] + extras["service"] + extras["las"]
    assert names == {Requirement(line).name for line in wanted} - {"pcdnf"}
    assert {"torch", "fastapi", "lazrs"} <= names
    assert not names & {"open3d", "pytest", "hypothesis", "trimesh"}


def test_constraints_pin_what_is_required_within_its_bounds() -> None:
    pins = {}
    for line in (DOCKER / "constraints.txt").read_text().splitlines():
        if not line.startswith("#"):
            name, version = line.split("==")
            pins[canonicalize_name(name)] = version
    for requirement in requirements():
        assert pins[canonicalize_name(requirement.name)] in requirement.specifier, requirement


def test_image_has_an_init_a_fixed_user_and_a_health_check() -> None:
    assert 'ENTRYPOINT ["tini", "--", "pcdnf-entrypoint"]' in DOCKERFILE
    assert re.search(r'^CMD \["pcdnf", "serve"\]$', DOCKERFILE, re.MULTILINE)
    assert re.search(r"^HEALTHCHECK .*\\\n +CMD \[", DOCKERFILE, re.MULTILINE)
    for target in ("cpu", "cuda"):
        stage = DOCKERFILE.split(f" AS {target}\n")[1].split("\nFROM ")[0]
        assert stage.strip().endswith("USER 10001:10001")


def test_the_build_script_labels_the_image_with_the_version(tmp_path: Path) -> None:
    engine = tmp_path / "docker"
    engine.write_text('#!/bin/sh\nprintf "%s\\n" "$@"\n')
    engine.chmod(0o755)
    environment = os.environ | {"ENGINE": "docker", "PATH": f"{tmp_path}:{os.environ['PATH']}"}
    done = subprocess.run(
        [ROOT / "scripts" / "build-image"], env=environment, capture_output=True, text=True, check=True
    )
    assert f"VERSION={__version__}" in done.stdout.splitlines()
    assert 'org.opencontainers.image.version="${VERSION}"' in DOCKERFILE


@pytest.mark.parametrize(
    "script",
    ["entrypoint", "install-dependencies", "install-package", "kernel-cpu", "make-base", "../scripts/build-image"],
)
def test_scripts_parse_and_can_be_executed(script: str) -> None:
    assert os.access(DOCKER / script, os.X_OK)
    subprocess.run(["sh", "-n", DOCKER / script], check=True)


def test_kernels_are_for_a_kind_of_cpu_that_llvm_knows() -> None:
    kind = subprocess.run([DOCKER / "kernel-cpu"], check=True, capture_output=True, text=True).stdout.strip()
    assert kind in ("x86-64-v3", "x86-64-v4", "generic")


def test_build_script_refuses_another_target() -> None:
    result = subprocess.run([ROOT / "scripts" / "build-image", "tpu"], capture_output=True, text=True)
    assert result.returncode == 2
    assert "cpu or cuda" in result.stderr


class Readiness(BaseHTTPRequestHandler):
    """Answers ``/readyz`` with the server's `status`."""

    def do_GET(self) -> None:
        status = self.server.status if self.path == "/readyz" else 404  # type: ignore[attr-defined]
        body = b'{"detail": "No worker is running."}'
        self.send_response(status)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: object) -> None:
        """Keep the test's output clean."""


@pytest.fixture
def server() -> Iterator[ThreadingHTTPServer]:
    with ThreadingHTTPServer(("127.0.0.1", 0), Readiness) as running:
        thread = threading.Thread(target=running.serve_forever)
        thread.start()
        yield running
        running.shutdown()
        thread.join()


def health(port: int, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, DOCKER / "healthcheck.py"],
        env={**os.environ, "PCDNF_PORT": str(port), **environment},
        capture_output=True,
        text=True,
    )


def test_health_check_passes_when_ready_and_takes_no_proxy(server: ThreadingHTTPServer) -> None:
    server.status = 200  # type: ignore[attr-defined]
    assert health(server.server_port, http_proxy="http://127.0.0.1:9").returncode == 0


def test_health_check_fails_with_the_services_words(server: ThreadingHTTPServer) -> None:
    server.status = 503  # type: ignore[attr-defined]
    result = health(server.server_port)
    assert result.returncode == 1
    assert result.stdout == '503 {"detail": "No worker is running."}\n'


def test_health_check_fails_when_nothing_listens(server: ThreadingHTTPServer) -> None:
    free = server.server_port
    server.server_close()
    result = health(free)
    assert result.returncode == 1
    assert "does not answer" in result.stdout
