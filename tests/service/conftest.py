"""An API without a worker for each test that asks."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import httpx
import pytest

from service.api.app import create_app
from service.settings import Settings
from tests.support.board import Board, MakeApi, open_board
from tests.support.servers import s3_server
from tests.support.service_process import Served, Service, write_sphere


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


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    """An API without a worker, shared by the tests of a module."""
    with Served(create_app(Settings(data_dir=tmp_path_factory.mktemp("api")))) as client:
        yield client


@pytest.fixture
def make_board(tmp_path: Path) -> Iterator[Callable[..., Board]]:
    """Makes a board with these settings, on a database of its own."""
    with ExitStack() as stack:
        yield lambda **given: stack.enter_context(
            open_board(Settings(data_dir=tmp_path / "data", job_ttl=1000, **given))
        )


@pytest.fixture
def board(make_board: Callable[..., Board]) -> Board:
    """A board on a database of its own."""
    return make_board()


@pytest.fixture(scope="session")
def s3(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    """The variables that lead to a server of the S3 protocol."""
    with s3_server(tmp_path_factory.mktemp("s3")) as variables:
        yield variables


@pytest.fixture
def bucket(s3: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> str:
    """The URL of storage of its own in a bucket."""
    for name, value in s3.items():
        monkeypatch.setenv(name, value)
    return f"s3://tests/{secrets.token_hex(4)}"


@pytest.fixture(scope="session")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A PLY of 2,000 points."""
    return write_sphere(tmp_path_factory.mktemp("clouds") / "small scan.ply", 2000)


@pytest.fixture(scope="module")
def done(running: Service, small: Path) -> dict[str, Any]:
    """A finished job of the small cloud, two iterations, seed 3."""
    return running.wait_status(running.submit(small, iterations=2, seed=3)["id"], "succeeded", "failed")
