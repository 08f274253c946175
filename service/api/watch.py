"""Coroutines that wait for a job to change. They share one query to the database, and without them there is none.

Workers are other processes, perhaps on other machines, so the API has to poll. A waiting request holds no thread.
"""

from __future__ import annotations

import asyncio
import logging
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager

from fastapi import Request
from sqlalchemy.exc import SQLAlchemyError
from starlette.concurrency import run_in_threadpool

from ..jobs.eta import Eta
from ..jobs.job import Job
from ..jobs.store import Jobs
from ..problems import Problem

log = logging.getLogger(__name__)

LOOK_SECONDS = 0.25
_WAIT = re.compile(r'^wait\s*=\s*"?(\d{1,9})"?\s*(?:;|$)', re.ASCII | re.IGNORECASE)


class Follower:
    """One coroutine's view of a job.

    Attributes
    ----------
    job : Job
        As last seen.
    eta : Eta
    ended : bool
        Whether no further change can follow: the job has finished or was removed, or this process stops.
    """

    def __init__(self, job: Job, eta: Eta) -> None:
        self.job, self.eta = job, eta
        self.ended = not job.live
        self._changed = asyncio.Event()

    async def change(self, seconds: float) -> bool:
        """Wait for a change at most so long, and return whether there was one."""
        try:
            async with asyncio.timeout(seconds):
                await self._changed.wait()
        except TimeoutError:
            return False
        self._changed.clear()
        return True

    def see(self, job: Job | None, eta: Eta) -> None:
        """Take over the present state from the database; None if the job was removed."""
        if job is None:
            self.end()
        elif (job, eta.queue_position) != (self.job, self.eta.queue_position):
            self.job, self.eta, self.ended = job, eta, self.ended or not job.live
            self._changed.set()

    def end(self) -> None:
        """Wake the coroutine for the last time."""
        self.ended = True
        self._changed.set()


class Watch:
    """Polls the jobs that requests follow.

    Parameters
    ----------
    jobs : Jobs
    most : int
        Followers at a time.
    """

    def __init__(self, jobs: Jobs, most: int) -> None:
        self._jobs, self._most = jobs, most
        self._followers: set[Follower] = set()
        self._looking: asyncio.Task[None] | None = None
        self._closed = False

    @property
    def full(self) -> bool:
        """Whether the limit of followers is reached."""
        return len(self._followers) >= self._most

    @contextmanager
    def following(self, job: Job, eta: Eta) -> Iterator[Follower]:
        """Follow a job.

        Raises
        ------
        Problem
            503 if the limit of followers is reached.
        """
        if self.full:
            raise Problem(
                "too_busy",
                f"{len(self._followers)} requests are already waiting for jobs, the limit of this service.",
                hint="Poll GET /jobs/{id} instead.",
                headers={"Retry-After": "5"},
                limit=self._most,
            )
        follower = Follower(job, eta)
        self._followers.add(follower)
        if self._closed:
            follower.end()
        elif self._looking is None or self._looking.done():
            self._looking = asyncio.create_task(self._look())
        try:
            yield follower
        finally:
            self._followers.discard(follower)

    async def finished(self, job: Job, seconds: float) -> Job:
        """Return the job once it has finished, or as it is after so many seconds.

        Raises
        ------
        Problem
            See :meth:`following`.
        """
        deadline = time.monotonic() + seconds
        with self.following(job, Eta(None, None)) as follower:
            while not follower.ended and (left := deadline - time.monotonic()) > 0:
                await follower.change(left)
            return follower.job

    def close(self) -> None:
        """Wake all followers, because this process stops."""
        self._closed = True
        for follower in self._followers:
            follower.end()

    async def _look(self) -> None:
        while self._followers and not self._closed:
            await asyncio.sleep(LOOK_SECONDS)
            followed = {follower.job.id for follower in self._followers if not follower.ended}
            try:
                seen = await run_in_threadpool(self._jobs.seen, followed)
            except SQLAlchemyError:
                log.exception("the job database did not answer; looking again")
                continue
            for follower in list(self._followers):
                if follower.job.id in followed and not follower.ended:
                    follower.see(*seen.get(follower.job.id, (None, follower.eta)))


def preferred_wait(request: Request, longest: int) -> int | None:
    """Return the seconds that ``Prefer: wait=N`` (RFC 7240) asks for, at most `longest`, or None."""
    for header in request.headers.getlist("prefer"):
        for preference in header.split(","):
            match = _WAIT.match(preference.strip())
            if match is not None:  # the first of several counts
                return min(int(match[1]), longest)
    return None
