"""Shares of one large job that several workers compute at the same time: the table of them, and the rule.

One job is shared at a time: where there are more large jobs, each has a worker of its own anyway, and a worker keeps
no more than one cloud beside those of its own lanes. A share counts deaths for itself, so that one that kills its
workers ends the job, however many others get done meanwhile.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import sqlalchemy as sa

from ..database.engine import exclusive
from ..database.tables import jobs as jobs_table
from ..database.tables import shares as table
from .attempts import patient
from .job import LIVE, Job, as_job

SHARE_TILES = 4  # of one share, which takes a worker some seconds
LEAST_SHARES = 4  # of a job that is worth the preparing of its cloud on more than one worker
Part = list[list[int]]  # tiles [start, stop] that follow one another


def share_id(job_id: str, iteration: int, start: int) -> str:
    """Return the id of the share of an iteration that begins with the tile at `start`."""
    return f"{job_id}-{iteration}-{start}"


def cut(tiles: Part) -> list[Part]:
    """Return the shares of an iteration's tiles; none where the job is too small for that."""
    parts = [tiles[first : first + SHARE_TILES] for first in range(0, len(tiles), SHARE_TILES)]
    return parts if len(parts) >= LEAST_SHARES else []


class Shares:
    """Changes workers make to the shares of jobs; those that :class:`Attempts` has, too, mean the same.

    Parameters
    ----------
    engine : sqlalchemy.Engine
    """

    def __init__(self, engine: sa.Engine) -> None:
        self._engine = engine

    @patient
    def take(self, job_id: str, iteration: int, points: int, parts: list[Part]) -> bool:
        """Begin to share an iteration over so many points; False while another job is shared."""
        rows = [
            {
                "id": share_id(job_id, iteration, part[0][0]),
                "job": job_id,
                "start": iteration * points + part[0][0],
                "done": 0,
                "open": False,
                "losses": 0,
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
    def release(self, job_id: str) -> None:
        """Let another job be shared."""
        with self._engine.begin() as connection:
            connection.execute(table.delete().where(table.c.job == job_id))

    @patient
    def open(self, share: str) -> Job | None:
        """Take a share up, counting a loss if it was left open; None if its job does not run any more."""
        losses = table.c.losses + sa.case((table.c.open, 1), else_=0)
        running = sa.select(jobs_table.c.id).where(jobs_table.c.status == "running")
        taken = table.update().where(table.c.id == share, table.c.job.in_(running)).values(losses=losses, open=True)
        with self._engine.begin() as connection:
            job_id = connection.execute(taken.returning(table.c.job)).scalar_one_or_none()
            if job_id is None:
                return None
            row = connection.execute(sa.select(jobs_table).where(jobs_table.c.id == job_id)).mappings().one()
        return self.part_of(as_job(row), share)

    @patient
    def part_of(self, job: Job, share: str) -> Job:
        """Return the job as the worker of a share sees it: what it does, and what died of it, count for the share."""
        with self._engine.connect() as connection:
            losses = connection.execute(sa.select(table.c.losses).where(table.c.id == share)).scalar()
        return replace(job, share=share, losses=losses or 0)

    def park(self, share: str) -> None:
        """See :meth:`service.jobs.attempts.Attempts.park`."""
        self._update(share, open=False, points_per_second=None)

    def resume(self, share: str) -> None:
        """See :meth:`service.jobs.attempts.Attempts.resume`."""
        self._update(share, open=True)

    def wanted(self, share: str, *, done: int, points_per_second: float | None) -> bool:
        """See :meth:`.attempts.Attempts.wanted`; `done` counts as if all shares before this one were done."""
        return self._report(share, done, points_per_second=points_per_second)

    def finished_tile(self, share: str, *, done: int, points_per_second: float | None) -> None:
        """See :meth:`service.jobs.attempts.Attempts.finished_tile`."""
        self._report(share, done, points_per_second=points_per_second, losses=0)

    @patient
    def _report(self, share: str, done: int, **values: Any) -> bool:
        mine = done - table.c.start
        query = table.update().where(table.c.id == share)
        query = query.values(done=sa.case((table.c.done > mine, table.c.done), else_=mine), **values)
        with self._engine.begin() as connection:
            job_id = connection.execute(query.returning(table.c.job)).scalar_one_or_none()
            if job_id is None:  # the iteration was merged, or the job ended
                return False
            sums = (sa.func.min(table.c.start) + sa.func.sum(table.c.done), sa.func.sum(table.c.points_per_second))
            total, pace = connection.execute(sa.select(*sums).where(table.c.job == job_id)).one()
            live = jobs_table.update().where(jobs_table.c.id == job_id, jobs_table.c.status.in_(LIVE))
            told = sa.case((jobs_table.c.done > int(total), jobs_table.c.done), else_=int(total))
            live = live.values(done=told, points_per_second=pace).returning(jobs_table.c.status)
            return connection.execute(live).scalar_one_or_none() == "running"

    @patient
    def _update(self, share: str, **values: Any) -> None:
        with self._engine.begin() as connection:
            connection.execute(table.update().where(table.c.id == share).values(**values))
