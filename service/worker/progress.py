"""Progress of a step."""

from __future__ import annotations

import time
from collections.abc import Callable

from pcdnf.denoiser import Stopped

from ..jobs.job import Job
from .context import Runtime

POLL_SECONDS = 1.0  # between two looks at whether the job is still wanted


class Progress:
    """Progress of one step, told to the database at most once a second, which also tells whether to go on.

    Parameters
    ----------
    base : int
        Points done before this step, over all iterations.
    give_way : callable, optional
        See :meth:`Runtime.at_work`.

    Attributes
    ----------
    lent : float
        Seconds in which tiles of other jobs went first.
    """

    def __init__(self, runtime: Runtime, job: Job, base: int, give_way: Callable[[], float] = lambda: 0.0) -> None:
        self._runtime, self._job, self._base, self._give_way = runtime, job, base, give_way
        self._done = 0
        self.lent = 0.0
        self._began = self._told = time.monotonic()

    def report(self, done: int) -> None:
        """Take note of the points of this step done so far."""
        self._done = done

    def stop(self) -> bool:
        """Return whether the job is not wanted any more; looks once a second."""
        self.lent += self._give_way()
        now = time.monotonic()
        if now - self._told < POLL_SECONDS:
            return False
        self._told = now
        speed = self._runtime.speed(form(self._job)) or (self._done / (now - self._began - self.lent) or None)
        record = self._runtime.record(self._job)
        return not record.wanted(self._job.work, done=self._base + self._done, points_per_second=speed)

    def check(self) -> None:
        """Raise :class:`pcdnf.denoiser.Stopped` where :meth:`stop` says so."""
        if self.stop():
            raise Stopped


def form(job: Job) -> str:
    """Return what sets a job's speed: its model, and whether it takes the fast form of it."""
    fast = job.parameters.get("fast", False)  # which jobs of before this release have not
    return f"{job.parameters['model']}{' fast' if fast else ''}"
