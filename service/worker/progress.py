"""Progress of a step: reported to the database, which answers whether the job was cancelled."""

from __future__ import annotations

import time
from collections.abc import Callable

from pcdnf.denoiser import StoppedError

from ..jobs.job import Job
from .context import Runtime
from .speeds import speed_key

POLL_SECONDS = 1.0  # between two reports


class Progress:
    """Progress of one step, reported at most once a second.

    Parameters
    ----------
    base : int
        Points done before this step, over all iterations.
    yield_to_smaller : callable, optional
        See :meth:`Runtime.at_work`.

    Attributes
    ----------
    yielded_seconds : float
        Seconds in which this step yielded to tiles of other jobs.
    """

    def __init__(
        self, runtime: Runtime, job: Job, base: int, yield_to_smaller: Callable[[], float] = lambda: 0.0
    ) -> None:
        self._runtime, self._job, self._base, self._yield = runtime, job, base, yield_to_smaller
        self._done = 0
        self.yielded_seconds = 0.0
        self._began = self._reported = time.monotonic()

    def report(self, done: int) -> None:
        """Set the number of points of this step done so far."""
        self._done = done

    def stop(self) -> bool:
        """Return whether the job was cancelled; asks the database once a second."""
        self.yielded_seconds += self._yield()
        now = time.monotonic()
        if now - self._reported < POLL_SECONDS:
            return False
        self._reported = now
        speed = self._runtime.speeds.of(speed_key(self._job)) or (
            self._done / (now - self._began - self.yielded_seconds) or None
        )
        record = self._runtime.record(self._job)
        return not record.report(self._job.work, done=self._base + self._done, points_per_second=speed)

    def check(self) -> None:
        """Raise :class:`pcdnf.denoiser.StoppedError` where :meth:`stop` says so."""
        if self.stop():
            raise StoppedError
