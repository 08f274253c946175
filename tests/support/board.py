"""The table of jobs without any process, for tests that look at both of its sides."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import httpx
import sqlalchemy as sa

from service.database.engine import create_engine
from service.database.migrations import migrate
from service.database.tables import jobs as jobs_table
from service.jobs.attempts import Attempts
from service.jobs.files import UPLOAD, job_file
from service.jobs.job import Job, new_id
from service.jobs.retention import Retention
from service.jobs.store import Jobs, NewJob
from service.jobs.worker_registry import Workers
from service.problems import Problem
from service.settings import Settings
from service.storage.base import Storage
from service.storage.open import open_storage


class MakeApi(Protocol):
    def __call__(self, **settings: Any) -> httpx.Client: ...


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

    def submit(
        self, *, owner: str = "ada", points: int = 100, iterations: int | str = 1, size: int = 6, name: str = "a"
    ) -> Job:
        """Accept a job with an upload of a few bytes."""
        job_id = new_id()
        scratch = self.storage.scratch()
        scratch.write_bytes(b"upload")
        self.storage.put(scratch, job_file(job_id, UPLOAD))
        upload = {"name": name, "format": "ply", "points": points, "bytes": size}
        new = NewJob(job_id, upload, warnings=[])
        return self.jobs.submit_all([new], owner=owner, parameters={"iterations": iterations})[0]

    def set(self, job_id: str, **values: Any) -> None:
        """Set columns of a job, whatever its state."""
        with self.engine.begin() as connection:
            connection.execute(jobs_table.update().where(jobs_table.c.id == job_id).values(**values))

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
    migrate(settings)
    engine = create_engine(settings)
    storage = open_storage(settings, patience=5)
    jobs = Jobs(engine, storage, settings)
    retention = Retention(engine, storage, jobs, settings)
    yield Board(settings, engine, storage, jobs, Attempts(engine, settings.job_ttl), Workers(engine), retention)
    jobs.close()
    engine.dispose()


def submit_at_once(board: Board, count: int, **job: Any) -> tuple[list[Job], list[str]]:
    """Submit so many jobs of as many callers at once; return those accepted and the codes of the refusals."""

    def submit(number: int) -> Job | str:
        try:
            return board.submit(owner=f"caller {number}", **job)
        except Problem as problem:
            return problem.code

    with ThreadPoolExecutor(count) as pool:
        answers = list(pool.map(submit, range(count)))
    return [each for each in answers if isinstance(each, Job)], [each for each in answers if isinstance(each, str)]
