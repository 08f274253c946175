"""How long a live job still takes: its place in the queue, and the speed that the workers measured."""

from __future__ import annotations

from dataclasses import dataclass

import sqlalchemy as sa

from .database import jobs as table
from .database import workers
from .job import Job


@dataclass(frozen=True)
class Outlook:
    """What is known about the time a live job still takes."""

    queue_position: int | None
    seconds_left: float | None


def speed(connection: sa.Connection) -> float | None:
    """Return the points a second that all workers make together; None before the first measured one."""
    found: float | None = connection.execute(sa.select(sa.func.sum(workers.c.points_per_second))).scalar()
    return found or None


def outlook(connection: sa.Connection, job: Job) -> Outlook:
    """Return place in the queue and estimated time."""
    if not job.live:
        return Outlook(None, None)
    every = speed(connection)
    if job.status != "queued":
        own = job.points_per_second or every
        return Outlook(None, (job.total - job.done) / own if own else None)
    ahead = sa.or_(
        table.c.status.in_(("running", "cancelling")),
        sa.and_(
            table.c.status == "queued",
            sa.tuple_(table.c.created_at, table.c.id) < sa.tuple_(job.created_at, job.id),
        ),
    )
    queued = sa.func.coalesce(sa.func.sum(sa.case((table.c.status == "queued", 1), else_=0)), 0)
    points = sa.func.coalesce(sa.func.sum(table.c.total - table.c.done), 0)
    position, before = connection.execute(sa.select(queued, points).where(ahead)).one()
    return Outlook(int(position) + 1, (float(before) + job.total) / every if every else None)
