"""The lifetime of results: until they expire, or until the disk needs their space."""

from __future__ import annotations

from collections import defaultdict, deque
from typing import Any

import sqlalchemy as sa

from ..database.tables import idempotency, now_ms
from ..database.tables import jobs as table
from ..problems import Problem
from ..settings import Settings
from ..storage.base import Storage
from .store import Jobs

EXPIRED_ROWS_KEPT_MS = 30 * 24 * 3600 * 1000  # how long an expired job is answered 410 rather than 404
LEASE_KEPT_MS = 3600 * 1000  # after the lease of an idempotency key that got no job
ORPHAN_SECONDS = 3600.0  # files without a job are an upload that was never accepted, or a late worker's
SCRATCH_SECONDS = 24 * 3600.0  # after which a half-written file has no writer any more


class Retention:
    """Removes expired jobs, and the oldest results if the budget of the disk is used up.

    Parameters
    ----------
    engine : sqlalchemy.Engine
    storage : Storage
    jobs : Jobs
    settings : Settings
    """

    def __init__(self, engine: sa.Engine, storage: Storage, jobs: Jobs, settings: Settings) -> None:
        self._engine = engine
        self._storage = storage
        self._jobs = jobs
        self._budget = settings.disk_budget_bytes
        self._min_free = settings.min_free_bytes

    def purge(self) -> int:
        """Remove the files of expired jobs, old rows, and files without a job; return the number of jobs expired."""
        now = now_ms()
        due = sa.select(table.c.id).where(table.c.expires_at <= now, table.c.purged_at.is_(None))
        with self._engine.connect() as connection:
            expired = list(connection.execute(due).scalars())
        for job_id in expired:
            self._expire(job_id)
        with self._engine.begin() as connection:
            connection.execute(table.delete().where(table.c.purged_at < now - EXPIRED_ROWS_KEPT_MS))
            unbound = idempotency.c.job.is_(None) & (idempotency.c.lease_until < now - LEASE_KEPT_MS)
            connection.execute(idempotency.delete().where(unbound))
        stored = self._storage.job_ids()  # before the rows are read, since a file comes before its row
        with self._engine.connect() as connection:
            known = set(connection.execute(sa.select(table.c.id).where(table.c.purged_at.is_(None))).scalars())
        for job_id in set(stored) - known:
            if self._storage.idle_seconds(job_id) > ORPHAN_SECONDS:
                self._storage.delete_job(job_id)
        self._storage.clear_scratch(SCRATCH_SECONDS)
        return len(expired)

    def make_room(self, needed: int = 0, *, keep: str | None = None) -> None:
        """Let results expire until `needed` bytes fit, or none if that would not be enough.

        The oldest go first, of the caller whose results take most at that moment.

        Parameters
        ----------
        needed : int
        keep : str, optional
            A job that must not go.

        Raises
        ------
        Problem
            503 if there is not enough room.
        """
        used = self._storage.used_bytes() if self._budget else 0
        free = self._storage.free_bytes()
        over = used + needed - self._budget if self._budget else 0
        lacking = self._min_free + needed - free
        short = max(over, lacking)
        if short <= 0:
            return
        query = (
            sa.select(table.c.id, table.c.owner)
            .where(table.c.status == "succeeded", table.c.purged_at.is_(None), table.c.id != (keep or ""))
            .order_by(table.c.finished_at, table.c.id)
        )
        with self._engine.connect() as connection:
            found = connection.execute(query).all()
        results: defaultdict[str, deque[tuple[str, int]]] = defaultdict(deque)  # of each caller, oldest first
        for job_id, owner in found:
            results[owner].append((job_id, self._storage.job_bytes(job_id)))
        taken = {owner: sum(size for _, size in each) for owner, each in results.items()}
        if sum(taken.values()) < short or (lacking > 0 and not self._storage.frees_disk):
            limit, actual = (self._budget, used + needed) if over == short else (free, self._min_free + needed)
            raise Problem(
                "disk_full",
                "The service does not have enough disk space for this.",
                hint="Delete jobs that you no longer need, or try again after the number of seconds in Retry-After.",
                headers={"Retry-After": "60"},
                limit=limit,
                actual=actual,
            )
        while short > 0:
            most = max(taken, key=lambda owner: taken[owner])
            job_id, size = results[most].popleft()
            taken[most] -= size
            short -= size
            self._expire(job_id)

    def _expire(self, job_id: str) -> None:
        row = table.update().where(table.c.id == job_id)
        now: Any = now_ms()
        with self._engine.begin() as connection:  # answered 410 from here on, before the files go
            connection.execute(row.where(table.c.expires_at > now).values(expires_at=now))
        self._storage.delete_job(job_id)
        self._jobs.forget(job_id)
        with self._engine.begin() as connection:
            connection.execute(row.values(purged_at=now))
