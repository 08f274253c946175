"""The worker's changes to jobs: acquire a lease, report progress, end the job.

A worker that crashes leaves its lease behind. The next worker that acquires the job counts a crash, and a finished tile
resets the count. A job that crashes its worker twice at the same tile therefore fails, while a job that lived through
two power failures goes on. While the database does not answer, the worker waits.
"""

from __future__ import annotations

import functools
import logging
import time
from collections.abc import Callable
from typing import Any, TypeVar, cast

import sqlalchemy as sa
from sqlalchemy.exc import DBAPIError, InterfaceError, OperationalError
from sqlalchemy.exc import TimeoutError as PoolTimeoutError

from ..database.tables import jobs as table
from ..database.tables import now_ms, shards
from . import outcomes
from .job import LIVE, Job, as_job

log = logging.getLogger(__name__)

MAX_CRASHES = 2
RETRY_SECONDS = 1.0

F = TypeVar("F", bound=Callable[..., Any])


def patient(method: F) -> F:
    """Retry a method until the database answers: it may be locked, full or unreachable."""

    @functools.wraps(method)
    def tries(*arguments: Any, **named: Any) -> Any:
        while True:
            try:
                return method(*arguments, **named)
            except (DBAPIError, PoolTimeoutError) as error:
                away = isinstance(error, OperationalError | InterfaceError | PoolTimeoutError)
                if not away and not (isinstance(error, DBAPIError) and error.connection_invalidated):
                    raise
                log.warning("the job database does not answer (%s); trying again", type(error).__name__)
                time.sleep(RETRY_SECONDS)

    return cast(F, tries)


class Attempts:
    """Changes a worker makes to jobs.

    Parameters
    ----------
    engine : sqlalchemy.Engine
    ttl : float
        Seconds that a finished job is kept.
    """

    def __init__(self, engine: sa.Engine, ttl: float) -> None:
        self._engine = engine
        self._ttl_ms = int(ttl * 1000)

    @patient
    def acquire(self, job_id: str) -> Job | None:
        """Acquire the lease of a job, and count a crash if it was not released; None if the job has ended."""
        query = (
            table.update()
            .where(table.c.id == job_id, table.c.status.in_(("queued", "running", "cancelling")))
            .values(
                status=sa.case((table.c.status == "queued", "running"), else_=table.c.status),
                started_at=sa.func.coalesce(table.c.started_at, now_ms()),
                crashes=table.c.crashes + sa.case((table.c.leased, 1), else_=0),
                leased=True,
            )
            .returning(table)
        )
        with self._engine.begin() as connection:
            row = connection.execute(query).mappings().one_or_none()
        return None if row is None else as_job(row)

    @patient
    def get(self, job_id: str) -> Job | None:
        """Return the job as it is now."""
        with self._engine.connect() as connection:
            row = connection.execute(sa.select(table).where(table.c.id == job_id)).mappings().one_or_none()
        return None if row is None else as_job(row)

    @patient
    def update(self, job_id: str, **values: Any) -> None:
        """Set columns of a job that has not ended; progress never goes back."""
        if "done" in values:
            values["done"] = _forward(values["done"])
        with self._engine.begin() as connection:
            connection.execute(table.update().where(table.c.id == job_id, table.c.status.in_(LIVE)).values(**values))

    @patient
    def report(self, job_id: str, *, done: int, points_per_second: float | None) -> bool:
        """Report progress, which never goes back, and return whether to go on: not after the job was cancelled."""
        query = (
            table.update()
            .where(table.c.id == job_id, table.c.status.in_(("running", "cancelling")))
            .values(done=_forward(done), points_per_second=points_per_second)
            .returning(table.c.status)
        )
        with self._engine.begin() as connection:
            return connection.execute(query).scalar_one_or_none() == "running"

    def release(self, job_id: str) -> None:
        """Release the lease, so that a crash from here on does not count against the job."""
        self.update(job_id, leased=False)

    def reacquire(self, job_id: str) -> None:
        """Acquire the lease again after this worker has released it."""
        self.update(job_id, leased=True)

    def finished_tile(self, job_id: str, *, done: int, points_per_second: float | None) -> None:
        """Report a tile that is stored. It resets the count of crashes."""
        self.update(job_id, crashes=0, done=done, points_per_second=points_per_second)

    @patient
    def succeed(self, job_id: str, results: dict[str, Any], warnings: list[str]) -> bool:
        """End a job as succeeded; False if it was cancelled before."""
        return self._end(
            job_id, ("running",), status="succeeded", results=results, warnings=warnings, done=table.c.total
        )

    @patient
    def cancel(self, job_id: str) -> bool:
        """End a job that a caller has cancelled; False if none has."""
        return self._end(job_id, ("cancelling",), status="cancelled")

    @patient
    def fail(self, job_id: str, problem: dict[str, Any]) -> bool:
        """End a job as failed; False if it had ended or was cancelled before."""
        return self._end(job_id, ("queued", "running"), status="failed", problem=problem)

    def live(self) -> list[str]:
        """Return the jobs that some worker is expected to be working on."""
        query = sa.select(table.c.id).where(table.c.status.in_(("running", "cancelling")))
        with self._engine.connect() as connection:
            return list(connection.execute(query).scalars())

    def _end(self, job_id: str, before: tuple[str, ...], **values: Any) -> bool:
        now = now_ms()
        query = (
            table.update()
            .where(table.c.id == job_id, table.c.status.in_(before))
            .values(leased=False, finished_at=now, expires_at=now + self._ttl_ms, **values)
        )
        with self._engine.begin() as connection:
            ended = connection.execute(query).rowcount == 1
            if ended:
                outcomes.count(connection, values["status"], values.get("problem", {}).get("code", ""))
        if ended:
            self._drop_shares(job_id)
        return ended

    @patient
    def _drop_shares(self, job_id: str) -> None:
        # In a separate transaction: a report on a shard locks the shard first and then the job.
        with self._engine.begin() as connection:
            connection.execute(shards.delete().where(shards.c.job == job_id))


def _forward(done: int) -> sa.ColumnElement[int]:
    return sa.case((table.c.done > done, table.c.done), else_=done)
