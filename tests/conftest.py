"""What all tests share."""

from __future__ import annotations

import os
from collections.abc import Generator
from pathlib import Path

import pytest

from tests.support.service_process import Service

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # several processes share the cores: none may spin


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of benchmark clouds; a test that asks for it is skipped where there is none."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("PCDNF_SHARED_DATA", beside))
    if not folder.is_dir():
        pytest.skip("no benchmark data: set PCDNF_SHARED_DATA")
    return folder


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call() -> Generator[None, object, object]:
    """Kill the services that a test started and, because it failed, did not stop; those of fixtures stay."""
    before = set(Service.alive)
    try:
        return (yield)
    finally:
        for service in Service.alive - before:
            service.kill()
