"""The time that an unfinished job still takes, from its place in the queue and the speed of the workers."""

from __future__ import annotations

from dataclasses import dataclass

import sqlalchemy as sa

from ..database.tables import jobs as table
from ..database.tables import now_ms, workers
from .job import Job
from .lanes import lane


@dataclass(frozen=True)
class Eta:
    """The estimated time of an unfinished job."""

    queue_position: int | None
    seconds_left: float | None


def speed(connection: sa.Connection, stale_seconds: float) -> float | None:
    """Return the points per second of all ready workers together; None before the first measurement.

    A worker without a heartbeat for `stale_seconds` does not count, nor one that starts or stops.
    """
    found: float | None = connection.execute(
        sa.select(sa.func.sum(workers.c.points_per_second)).where(*_at_work(stale_seconds))
    ).scalar()
    return found or None


def _at_work(stale_seconds: float) -> tuple[sa.ColumnElement[bool], ...]:
    return (workers.c.state == "ready", workers.c.beat_at >= now_ms() - int(stale_seconds * 1000))


def estimate(connection: sa.Connection, job: Job, stale_seconds: float) -> Eta:
    """Return the place in the queue and the estimated time; see :func:`speed` for `stale_seconds`.

    The jobs in flight share the device evenly. Until a job is finished, each of the others computes as many points as
    it does, or what it has left.
    """
    if not job.live:
        return Eta(None, None)
    every = speed(connection, stale_seconds)
    left = job.total - job.done
    position, before = None, 0
    if job.status == "queued":
        position, before = _ahead(connection, job)
        pace = every
    else:
        count = connection.execute(sa.select(sa.func.count(workers.c.id)).where(*_at_work(stale_seconds))).scalar() or 1
        pace = job.points_per_second or (every and every / count)
    others = _others(connection, job, before + left)
    if job.status != "queued" and every and pace:
        others = others * pace / every  # jobs of other workers do not slow this one down
    return Eta(position, (before + left + others) / pace if pace else None)


def _ahead(connection: sa.Connection, job: Job) -> tuple[int, int]:
    """Return the job's place in its lane, and the work of those ahead of it there."""
    size = lane(job.total)
    first = sa.tuple_(table.c.created_at, table.c.id) < sa.tuple_(job.created_at, job.id)
    query = sa.select(sa.func.count(), sa.func.coalesce(sa.func.sum(table.c.total - table.c.done), 0)).where(
        table.c.status == "queued", table.c.total > size.above, table.c.total <= size.upto, first
    )
    ahead, points = connection.execute(query).one()
    return int(ahead) + 1, int(points)


def _others(connection: sa.Connection, job: Job, work: int) -> float:
    """Return the points that the other jobs in flight compute while this one computes `work`."""
    left = table.c.total - table.c.done
    query = sa.select(sa.func.coalesce(sa.func.sum(sa.case((left < work, left), else_=work)), 0)).where(
        table.c.status == "running", table.c.id != job.id
    )
    return float(connection.execute(query).scalar_one())
