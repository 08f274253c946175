"""Jobs as the API uses them: submit, look up, cancel, list, remove. The job engine behind the queue is DBOS.

Callers see our own table; the state of the engine is an implementation detail. Every change of status is a conditional
UPDATE, so the API and a worker that act at the same moment cannot both succeed.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import sqlalchemy as sa
from dbos import DBOSClient, EnqueueOptions

from ..database.engine import exclusive
from ..database.tables import jobs as table
from ..database.tables import now_ms
from ..settings import Settings
from ..storage.base import Storage
from ..telemetry import tracing
from . import callback, drain_switch, outcomes
from .admission import Admission, Load
from .dbos_contract import APPLICATION_NAME, APPLICATION_VERSION, SERIALIZER, WORKFLOW
from .eta import Eta, estimate
from .job import FINISHED, Job, as_job, is_id
from .lanes import lane

USUAL_ITERATIONS = 2  # what iterations=auto is taken for until the worker has looked at the cloud


@dataclass(frozen=True)
class NewJob:
    """A job to accept; its upload is stored already."""

    id: str
    upload: dict[str, Any]
    warnings: list[str]


def _in_order(jobs: Iterable[Job]) -> list[Job]:
    """Return the jobs of one request in the order of their files."""
    return sorted(jobs, key=lambda job: job.place or 0)


class Jobs:
    """The queue and its table, from a process that runs no work itself.

    Parameters
    ----------
    engine : sqlalchemy.Engine
        Of the job database, already migrated.
    storage : Storage
        Of the files of jobs.
    settings : Settings
        For the bounds of the queue and the time that a finished job is kept.
    """

    def __init__(self, engine: sa.Engine, storage: Storage, settings: Settings) -> None:
        self._engine = engine
        self._storage = storage
        self._admission = Admission(settings)
        self._ttl_ms = int(settings.job_ttl * 1000)
        self._stale_seconds = settings.worker_stale_seconds
        self._usual_iterations = min(USUAL_ITERATIONS, settings.max_iterations)
        self._client = DBOSClient(
            system_database_engine=engine,
            application_name=APPLICATION_NAME,
            serializer=SERIALIZER,
            retry_connection_errors=False,
        )

    def close(self) -> None:
        """Close the client of the job engine."""
        self._client.destroy()

    def check_room(self, owner: str, asked: Load) -> None:
        """Refuse a job early that :meth:`submit` would most likely refuse; see :meth:`Admission.check`."""
        with self._engine.connect() as connection:
            drain_switch.check_open(connection)
            self._admission.check(connection, owner, asked)

    def submit_all(
        self,
        new: Sequence[NewJob],
        *,
        owner: str,
        parameters: dict[str, Any],
        batch: str | None = None,
        also: Callable[[sa.Connection], None] | None = None,
    ) -> list[Job]:
        """Accept jobs whose uploads are stored durably: all or none.

        Our rows, those of the queue and `also` are one transaction.

        Raises
        ------
        Problem
            If the service is draining, if there is no room (:meth:`Admission.check`), or by `also`.
        """
        with self._engine.connect() as connection, exclusive(connection):
            drain_switch.check_open(connection)
            for place, each in enumerate(new):
                self._insert(connection, each, owner=owner, parameters=parameters, batch=batch, place=place)
            if also is not None:
                also(connection)
            ids = [each.id for each in new]
            rows = connection.execute(sa.select(table).where(table.c.id.in_(ids))).mappings().all()
        return _in_order(map(as_job, rows))

    def _insert(
        self,
        connection: sa.Connection,
        new: NewJob,
        *,
        owner: str,
        parameters: dict[str, Any],
        batch: str | None,
        place: int,
    ) -> None:
        iterations = parameters["iterations"]
        total = new.upload["points"] * (self._usual_iterations if iterations == "auto" else iterations)
        self._admission.check(connection, owner, Load(total, new.upload["bytes"], 1))
        values = {
            "id": new.id,
            "owner": owner,
            "status": "queued",
            "parameters": parameters,
            "upload": new.upload,
            "warnings": new.warnings,
            "done": 0,
            "total": total,
            "created_at": now_ms(),
            "leased": False,
            "crashes": 0,
            "context": tracing.carried(),
            "batch": batch,
            "place": place,
            "callback": "due" if parameters.get("callback_url") else None,
        }
        connection.execute(table.insert().values(values))
        options: EnqueueOptions = {
            "workflow_name": WORKFLOW,
            "queue_name": lane(total).queue,
            "workflow_id": new.id,
            "app_version": APPLICATION_VERSION,
        }
        self._client.enqueue_in_transaction(connection, options, new.id)

    def status(self, job_id: str, owner: str) -> Job | None:
        """Return the job, or None if `owner` has no such job."""
        if not is_id(job_id):
            return None
        query = sa.select(table).where(table.c.id == job_id, table.c.owner == owner)
        with self._engine.connect() as connection:
            row = connection.execute(query).mappings().one_or_none()
        return None if row is None else as_job(row)

    def expired(self, job: Job) -> bool:
        """Return whether the files of `job` have expired."""
        if job.expires_at is None:
            return False
        with self._engine.connect() as connection:
            now: int = connection.execute(sa.select(now_ms())).scalar_one()
        return job.expires_at <= now

    def page(
        self,
        owner: str,
        *,
        limit: int,
        before: Job | None = None,
        statuses: Collection[str] = (),
        name: str | None = None,
    ) -> tuple[list[Job], int]:
        """Return a page of the jobs of `owner`, newest first, and how many jobs there are on all pages.

        Parameters
        ----------
        owner : str
        limit : int
            Most jobs of the page.
        before : Job, optional
            Only jobs older than this one are on the page.
        statuses : collection of str
            Only jobs with one of these; all jobs without any.
        name : str, optional
            Only jobs whose upload has this in its name, in any case.
        """
        asked = (table.c.owner == owner) & table.c.purged_at.is_(None)
        if statuses:
            asked &= table.c.status.in_(statuses)
        if name is not None:
            asked &= table.c.upload["name"].as_string().icontains(name, autoescape=True)
        query = sa.select(table).where(asked)
        if before is not None:
            query = query.where(sa.tuple_(table.c.created_at, table.c.id) < sa.tuple_(before.created_at, before.id))
        query = query.order_by(table.c.created_at.desc(), table.c.id.desc()).limit(limit)
        with self._engine.connect() as connection:
            total = connection.execute(sa.select(sa.func.count()).select_from(table).where(asked)).scalar_one()
            return [as_job(row) for row in connection.execute(query).mappings()], total

    def batch(self, batch_id: str, owner: str) -> list[Job]:
        """Return the jobs of a batch of `owner` in the order of their files; none if there is no such batch."""
        if not is_id(batch_id):
            return []
        query = sa.select(table).where(table.c.batch == batch_id, table.c.owner == owner, table.c.purged_at.is_(None))
        with self._engine.connect() as connection:
            return _in_order(as_job(row) for row in connection.execute(query).mappings())

    def eta(self, job: Job) -> Eta:
        """Return place in the queue and estimated time, from the speed the workers measured."""
        with self._engine.connect() as connection:
            return estimate(connection, job, self._stale_seconds)

    def seen(self, job_ids: Collection[str]) -> dict[str, tuple[Job, Eta]]:
        """Return the present state of these jobs, of any owner, without those that were removed."""
        with self._engine.connect() as connection:
            rows = connection.execute(sa.select(table).where(table.c.id.in_(job_ids))).mappings().all()
        return {job.id: (job, self.eta(job)) for job in map(as_job, rows)}

    def cancel(self, job: Job) -> Job | None:
        """Cancel a live job: at once if it is queued, otherwise as soon as its worker notices.

        Returns the job as it is now, or None if it went in the meantime.
        """
        now = now_ms()
        queued = (
            table.update()
            .where(table.c.id == job.id, table.c.status == "queued")
            .values(status="cancelled", finished_at=now, expires_at=now + self._ttl_ms)
        )
        running = table.update().where(table.c.id == job.id, table.c.status == "running").values(status="cancelling")
        with self._engine.begin() as connection:
            gone = connection.execute(queued).rowcount == 1
            if gone:
                outcomes.count(connection, "cancelled")
            else:
                connection.execute(running)
        if gone:
            # Should this be cut off, the worker that takes it off the queue finds it cancelled and clears it away.
            self._storage.delete_job(job.id)
            self._client.cancel_workflow(job.id)
        return self.status(job.id, job.owner)

    def add_result(self, job: Job, format_: str, facts: dict[str, Any], warnings: list[str]) -> Job | None:
        """Record that the result of a finished job is available in one more format.

        Returns the job as it is now, or None if it was removed or expired in the meantime.
        """
        there = (table.c.id == job.id) & (table.c.status == "succeeded") & (table.c.expires_at > now_ms())
        with self._engine.connect() as connection, exclusive(connection):
            row = connection.execute(sa.select(table).where(there)).mappings().one_or_none()
            if row is None:
                return None
            now = as_job(row)
            # Another API process may have added this format or another one meanwhile.
            results = {format_: facts} | (now.results or {})
            all_warnings = now.warnings + [warning for warning in warnings if warning not in now.warnings]
            connection.execute(
                table.update().where(table.c.id == job.id).values(results=results, warnings=all_warnings)
            )
        return replace(now, results=results, warnings=all_warnings)

    def remove(self, job: Job) -> bool:
        """Remove a finished job, its files and its row; False if it is live."""
        ended = (table.c.id == job.id) & table.c.status.in_(FINISHED)
        with self._engine.connect() as connection:
            if connection.execute(sa.select(table.c.id).where(ended)).scalar() is None:
                return False
        self.forget(job.id)  # first: without our row it would be lost, while files without a row are purged
        with self._engine.begin() as connection:
            removed = connection.execute(table.delete().where(ended)).rowcount == 1
        self._storage.delete_job(job.id)
        return removed

    def forget(self, job_id: str) -> None:
        """Remove the engine's record of a finished job, and of its callback."""
        self._client.delete_workflows([job_id, *callback.workflow_ids(job_id)], delete_children=True)
