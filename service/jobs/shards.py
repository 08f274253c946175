"""Shards of a large job, which several workers compute at the same time.

Only one job is divided at a time. If there are more large jobs, each has a worker anyway, and a worker then keeps at
most one cloud more than its lanes allow. Each shard counts its own crashes. A shard that crashes its workers therefore
ends the job, even if other shards succeed meanwhile.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import sqlalchemy as sa

from ..database.engine import exclusive
from ..database.tables import jobs as jobs_table
from ..database.tables import shards as table
from .attempts import patient
from .job import LIVE, Job, as_job

SHARD_TILES = 4  # of one shard, some seconds of work
LEAST_SHARDS = 4  # of a job: below, preparing the cloud on several workers does not pay
Part = list[list[int]]  # tiles [start, stop] that follow one another


def shard_id(job_id: str, iteration: int, start: int) -> str:
    """Return the id of the shard of an iteration that begins with the tile at `start`."""
    return f"{job_id}-{iteration}-{start}"


def cut(tiles: Part) -> list[Part]:
    """Return the shards of an iteration's tiles; none if the job is too small for shards."""
    parts = [tiles[first : first + SHARD_TILES] for first in range(0, len(tiles), SHARD_TILES)]
    return parts if len(parts) >= LEAST_SHARDS else []


class Shards:
    """The workers' changes to shards; the methods that :class:`Attempts` has as well mean the same.

    Parameters
    ----------
    engine : sqlalchemy.Engine
    """

    def __init__(self, engine: sa.Engine) -> None:
        self._engine = engine

    @patient
    def begin(self, job_id: str, iteration: int, points: int, parts: list[Part]) -> bool:
        """Begin the shards of an iteration over so many points; False while another job is divided."""
        rows = [
            {
                "id": shard_id(job_id, iteration, part[0][0]),
                "job": job_id,
                "start": iteration * points + part[0][0],
                "done": 0,
                "leased": False,
                "crashes": 0,
            }
            for part in parts
        ]
        other = sa.select(table.c.id).join(jobs_table, jobs_table.c.id == table.c.job)
        other = other.where(table.c.job != job_id, jobs_table.c.status.in_(LIVE)).limit(1)
        known = sa.select(table.c.id).where(table.c.id == rows[0]["id"])
        with self._engine.connect() as connection, exclusive(connection):
            if connection.execute(other).first() is not None:
                return False
            if connection.execute(known).first() is None:
                connection.execute(table.insert(), rows)
            return True

    @patient
    def finish(self, job_id: str) -> None:
        """Remove the shards of a job, so that another job may be divided."""
        with self._engine.begin() as connection:
            connection.execute(table.delete().where(table.c.job == job_id))

    @patient
    def acquire(self, shard: str) -> Job | None:
        """Acquire the lease of a shard, and count a crash if it was not released; None if its job has ended."""
        crashes = table.c.crashes + sa.case((table.c.leased, 1), else_=0)
        running = sa.select(jobs_table.c.id).where(jobs_table.c.status == "running")
        taken = table.update().where(table.c.id == shard, table.c.job.in_(running)).values(crashes=crashes, leased=True)
        with self._engine.begin() as connection:
            job_id = connection.execute(taken.returning(table.c.job)).scalar_one_or_none()
            if job_id is None:
                return None
            row = connection.execute(sa.select(jobs_table).where(jobs_table.c.id == job_id)).mappings().one()
        return self.part_of(as_job(row), shard)

    @patient
    def part_of(self, job: Job, shard: str) -> Job:
        """Return the job with the id and the crashes of a shard, as the worker of the shard needs it."""
        with self._engine.connect() as connection:
            crashes = connection.execute(sa.select(table.c.crashes).where(table.c.id == shard)).scalar()
        return replace(job, shard=shard, crashes=crashes or 0)

    def release(self, shard: str) -> None:
        """See :meth:`service.jobs.attempts.Attempts.release`."""
        self._update(shard, leased=False, points_per_second=None)

    def reacquire(self, shard: str) -> None:
        """See :meth:`service.jobs.attempts.Attempts.reacquire`."""
        self._update(shard, leased=True)

    def report(self, shard: str, *, done: int, points_per_second: float | None) -> bool:
        """See :meth:`.attempts.Attempts.report`; `done` counts as if all shards before this one were done."""
        return self._record(shard, done, points_per_second=points_per_second)

    def finished_tile(self, shard: str, *, done: int, points_per_second: float | None) -> None:
        """See :meth:`service.jobs.attempts.Attempts.finished_tile`."""
        self._record(shard, done, points_per_second=points_per_second, crashes=0)

    @patient
    def _record(self, shard: str, done: int, **values: Any) -> bool:
        mine = done - table.c.start
        query = table.update().where(table.c.id == shard)
        query = query.values(done=sa.case((table.c.done > mine, table.c.done), else_=mine), **values)
        with self._engine.begin() as connection:
            job_id = connection.execute(query.returning(table.c.job)).scalar_one_or_none()
            if job_id is None:  # the iteration was merged, or the job ended
                return False
            sums = (sa.func.min(table.c.start) + sa.func.sum(table.c.done), sa.func.sum(table.c.points_per_second))
            total, pace = connection.execute(sa.select(*sums).where(table.c.job == job_id)).one()
            live = jobs_table.update().where(jobs_table.c.id == job_id, jobs_table.c.status.in_(LIVE))
            reported = sa.case((jobs_table.c.done > int(total), jobs_table.c.done), else_=int(total))
            live = live.values(done=reported, points_per_second=pace).returning(jobs_table.c.status)
            return connection.execute(live).scalar_one_or_none() == "running"

    @patient
    def _update(self, shard: str, **values: Any) -> None:
        with self._engine.begin() as connection:
            connection.execute(table.update().where(table.c.id == shard).values(**values))
