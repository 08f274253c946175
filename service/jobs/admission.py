"""The limits of the queue, and whether it has room for a job.

The queue is bounded in points and in bytes, and so is the part of it that one caller may fill. Counting and accepting
are one transaction (:func:`service.database.engine.exclusive`), so the bounds hold for simultaneous requests too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import sqlalchemy as sa

from ..database.tables import jobs as table
from ..problems import Problem
from ..settings import Settings
from .eta import speed
from .job import LIVE

SHORTEST_RETRY, UNKNOWN_RETRY, LONGEST_RETRY = 1, 30, 3600  # seconds


@dataclass(frozen=True)
class Load:
    """A load of unfinished jobs: points times iterations still to do, bytes of their uploads, their number."""

    points: int = 0
    bytes: int = 0
    jobs: int = 0


class Admission:
    """Accepts or refuses jobs.

    Parameters
    ----------
    settings : Settings
    """

    def __init__(self, settings: Settings) -> None:
        self._all = Load(settings.max_queued_points, settings.max_queued_bytes)
        self._stale_seconds = settings.worker_stale_seconds
        self._caller = Load(settings.max_caller_points, settings.max_caller_bytes, settings.max_caller_jobs)

    def check(self, connection: sa.Connection, owner: str, asked: Load) -> None:
        """Check that there is room for the load `asked`.

        Raises
        ------
        Problem
            413 if the load would not fit into an empty queue, 429 if this caller has reached a limit of its key, 503 if
            the queue is full.
        """
        self._too_large(asked)
        all_load, own = _loads(connection, owner)
        pace = speed(connection, self._stale_seconds)
        for name in ("points", "bytes", "jobs"):
            limit, used, more = (getattr(load, name) for load in (self._caller, own, asked))
            if used + more > limit:
                raise Problem(
                    "quota_exceeded",
                    f"With this job your unfinished jobs would have {used + more} {name}. The limit is {limit}.",
                    hint="Wait until some of your jobs have finished, or cancel one of them.",
                    headers={"Retry-After": _seconds(used + more - limit, used, own.points, pace)},
                    unit=name,
                    limit=limit,
                    actual=used + more,
                )
        for name in ("points", "bytes"):
            limit, used, more = (getattr(load, name) for load in (self._all, all_load, asked))
            if used + more > limit:
                raise Problem(
                    "queue_full",
                    f"With this job the queue would hold {used + more} {name}. The limit is {limit}.",
                    hint="Send the file again after the number of seconds in Retry-After.",
                    headers={"Retry-After": _seconds(used + more - limit, used, all_load.points, pace)},
                    unit=name,
                    limit=limit,
                    actual=used + more,
                )

    def _too_large(self, asked: Load) -> None:
        limit = min(self._all.points, self._caller.points)
        if asked.points > limit:
            raise Problem(
                "too_much_work",
                f"The job has {asked.points} points times iterations. The limit of the queue is {limit}.",
                hint="Ask for fewer iterations, or split the cloud into smaller parts.",
                limit=limit,
                actual=asked.points,
            )
        limit = min(self._all.bytes, self._caller.bytes)
        if asked.bytes > limit:
            raise Problem(
                "upload_too_large",
                f"The upload has {asked.bytes} bytes. The limit of the queue is {limit}.",
                hint="Send a smaller cloud, or a binary file in place of text.",
                limit=limit,
                actual=asked.bytes,
            )


def _loads(connection: sa.Connection, owner: str) -> tuple[Load, Load]:
    """Return the load of all callers and of one."""
    size = sa.cast(table.c.upload["bytes"].as_string(), sa.BigInteger)
    query = sa.select(
        sa.func.coalesce(sa.func.sum(table.c.total - table.c.done), 0),
        sa.func.coalesce(sa.func.sum(size), 0),
        sa.func.count(),
    ).where(table.c.status.in_(LIVE))
    all_load, own = (connection.execute(each).one() for each in (query, query.where(table.c.owner == owner)))
    return Load(*map(int, all_load)), Load(*map(int, own))


def _seconds(excess: int, used: int, points: int, pace: float | None) -> str:
    """Return the seconds until `excess` of `used` is worked off, if `points` are at `pace`."""
    if not pace or not used:
        return str(UNKNOWN_RETRY)
    return str(min(LONGEST_RETRY, max(SHORTEST_RETRY, math.ceil(min(1.0, excess / used) * points / pace))))
