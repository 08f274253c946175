"""One running service for the whole session, and an API without a worker for each test that asks."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Protocol

import httpx
import pytest
from service_process import Served, Service, write_sphere

from service.app import create_app
from service.settings import Settings


@pytest.fixture(scope="session")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """The service with its worker; shared, so leave no job behind that the next test would wait for."""
    service = Service(tmp_path_factory.mktemp("running")).start()
    yield service
    assert service.stop() == 0, service.output()


class MakeApi(Protocol):
    def __call__(self, **settings: Any) -> httpx.Client: ...


@pytest.fixture
def make_served(tmp_path: Path) -> Iterator[Callable[..., Served]]:
    """Makes APIs that have no worker, so that jobs stay queued, all on one folder."""
    with ExitStack() as stack:

        def make(**settings: Any) -> Served:
            served = Served(create_app(Settings(data_dir=tmp_path / "data", **settings)))
            stack.enter_context(served)
            return served

        yield make


@pytest.fixture
def make_api(make_served: Callable[..., Served]) -> MakeApi:
    """As `make_served`, but returns the client."""
    return lambda **settings: make_served(**settings).client


@pytest.fixture
def api(make_api: MakeApi) -> httpx.Client:
    """An API without a worker."""
    return make_api()


@pytest.fixture(scope="session")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A PLY of 2,000 points."""
    return write_sphere(tmp_path_factory.mktemp("clouds") / "small scan.ply", 2000)
