"""What all tests share."""

from __future__ import annotations

import os
from collections.abc import Generator, Iterator
from pathlib import Path

import pytest

from tests.support.service_process import KEY, Service

pytest_plugins = ["tests.support.selection"]
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # several processes share the cores: none may spin


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of benchmark clouds; a test that asks for it is skipped where there is none."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("PCDNF_SHARED_DATA", beside))
    if not folder.is_dir():
        pytest.skip("no benchmark data: set PCDNF_SHARED_DATA")
    return folder


@pytest.fixture(scope="session")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """The service with its worker, one a process of tests; leave no job behind that the next test would wait for."""
    service = Service(tmp_path_factory.mktemp("running")).start()
    yield service
    assert service.stop() == 0, service.output()


@pytest.fixture(scope="session")
def url(running: Service) -> str:
    """Its address."""
    return str(running.client.base_url).rstrip("/")


@pytest.fixture(scope="session")
def keyed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """A service whose only key is `KEY`."""
    service = Service(tmp_path_factory.mktemp("keyed"), api_key=KEY).start()
    yield service
    assert service.stop() == 0, service.output()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call() -> Generator[None, object, object]:
    """Kill the services that a test started and, because it failed, did not stop; those of fixtures stay."""
    before = set(Service.alive)
    try:
        return (yield)
    finally:
        for service in Service.alive - before:
            service.kill()
