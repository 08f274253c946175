"""One running service for the whole session, and an API without a worker for each test that asks."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import httpx
import pytest
import sqlalchemy as sa
from servers import s3_server
from service_process import Served, Service, write_sphere

from service import database
from service.app import create_app
from service.attempts import Attempts
from service.job import Job, new_id
from service.jobs import Jobs
from service.retention import Retention
from service.settings import Settings
from service.storage import UPLOAD, Storage, job_file, open_storage
from service.workers import Workers


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


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    """An API without a worker, shared by the tests of a module."""
    with Served(create_app(Settings(data_dir=tmp_path_factory.mktemp("api")))) as client:
        yield client


@dataclass
class Board:
    """The table of jobs from both of its sides, without any process."""

    settings: Settings
    engine: sa.Engine
    storage: Storage
    jobs: Jobs
    attempts: Attempts
    workers: Workers
    retention: Retention

    def submit(self, *, owner: str = "ada", points: int = 100, iterations: int = 1, size: int = 6) -> Job:
        """Accept a job with an upload of a few bytes."""
        job_id = new_id()
        scratch = self.storage.scratch()
        scratch.write_bytes(b"upload")
        self.storage.put(scratch, job_file(job_id, UPLOAD))
        return self.jobs.submit(
            job_id,
            owner=owner,
            parameters={"iterations": iterations},
            upload={"name": "a", "format": "ply", "points": points, "bytes": size},
            warnings=[],
        )

    def set(self, job_id: str, **values: Any) -> None:
        """Set columns of a job, whatever its state."""
        with self.engine.begin() as connection:
            connection.execute(database.jobs.update().where(database.jobs.c.id == job_id).values(**values))

    def path(self, job: Job, name: str) -> Path:
        """Return where a file of a job lies."""
        return self.settings.data_dir / job_file(job.id, name)

    def now(self, job: Job) -> Job:
        """Return the job as it is now."""
        found = self.attempts.get(job.id)
        assert found is not None
        return found

    def engine_state(self, job: Job) -> str | None:
        """Return what the engine thinks of the job."""
        query = sa.text("SELECT status FROM workflow_status WHERE workflow_uuid = :id")
        with self.engine.connect() as connection:
            state: str | None = connection.execute(query, {"id": job.id}).scalar()
            return state


@contextmanager
def open_board(settings: Settings) -> Iterator[Board]:
    """Open a board on the database of `settings`."""
    database.migrate(settings)
    engine = database.create_engine(settings)
    storage = open_storage(settings, patience=5)
    jobs = Jobs(engine, storage, settings)
    retention = Retention(engine, storage, jobs, settings)
    yield Board(settings, engine, storage, jobs, Attempts(engine, settings.job_ttl), Workers(engine), retention)
    jobs.close()
    engine.dispose()


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
