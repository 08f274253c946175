"""The scheduler of a worker: which of the jobs in flight computes.

One tile is computed at a time, of the job with the fewest points left. Between two batches a tile yields to a tile of a
smaller job. Every fourth grant goes to the job that was submitted first. That tile does not yield, so a stream of small
jobs cannot hold up a large one for ever. Reading, preparing, merging and writing run beside the tiles.

Crash suspects run in isolation. With several jobs in flight, a crash does not identify the job that caused it. Each job
that was computing counts a crash and then runs alone until it finishes a tile, so a second crash can be attributed.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

OLDEST_EVERY = 4
POLL_SECONDS = 1.0


@dataclass(frozen=True, eq=False)
class Request:
    """A request to compute: a tile of a job with `left` points to do, or other work if None."""

    job: str
    submitted: int
    left: int | None
    isolated: bool
    waits: Callable[[], None]
    poll: Callable[[], None]


@dataclass(frozen=True)
class Grant:
    """Permission to compute: whether the job had to wait, and a function that yields and returns whether it did."""

    waited: bool
    yield_to_smaller: Callable[[], bool]


class Scheduler:
    """Grants requests of the workflows of one worker.

    Parameters
    ----------
    always_isolated : bool
        Never run two jobs at the same time, because a library supports only one caller.
    """

    def __init__(self, *, always_isolated: bool = False) -> None:
        self._always_isolated = always_isolated
        self._changed = threading.Condition()
        self._waiting: list[Request] = []
        self._working: list[Request] = []
        self._granted = 0
        self._pinned: Request | None = None  # does not yield
        self._closed = False

    @property
    def computing(self) -> str | None:
        """The job whose tile is being computed."""
        return next((request.job for request in list(self._working) if request.left is not None), None)

    def close(self) -> None:
        """Grant no more requests. Work that was granted goes on to its end."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    @contextmanager
    def work(
        self,
        job: str,
        *,
        submitted: int,
        left: int | None = None,
        isolated: bool = False,
        waits: Callable[[], None],
        poll: Callable[[], None],
    ) -> Iterator[Grant]:
        """Work on a job, as soon as it may.

        Parameters
        ----------
        job : str
        submitted : int
            When, to find the oldest.
        left : int, optional
            Points still to do; for a tile, which takes a turn.
        isolated : bool
            While no other job works.
        waits : callable
            Called whenever the job has to wait.
        poll : callable
            Called every second while it waits; may raise to give up.

        Yields
        ------
        Grant
        """
        request = Request(job, submitted, left, isolated or self._always_isolated, waits, poll)
        with self._changed:
            self._waiting.append(request)
        try:
            yield Grant(self._wait(request), lambda: self._yield_to_smaller(request))
        finally:
            with self._changed:
                (self._working if request in self._working else self._waiting).remove(request)
                self._changed.notify_all()

    def _wait(self, request: Request) -> bool:
        if self._begin(request, 0.0):
            return False
        request.waits()
        while not self._begin(request, POLL_SECONDS):
            request.poll()
        return True

    def _yield_to_smaller(self, request: Request) -> bool:
        with self._changed:
            if (
                self._closed
                or request is self._pinned
                or any(other.isolated for other in (*self._waiting, *self._working))
            ):
                return False
            others = [other.left for other in self._waiting if other.left is not None and other.job != request.job]
            if all(left >= (request.left or 0) for left in others):
                return False
            self._working.remove(request)
            self._waiting.append(request)
            self._changed.notify_all()
        return self._wait(request)

    def _begin(self, request: Request, seconds: float) -> bool:
        with self._changed:
            if not self._changed.wait_for(lambda: self._closed or self._may(request), seconds) or self._closed:
                return False
            if request.left is not None:
                contended = any(other.left is not None for other in self._waiting if other is not request)
                self._pinned = request if contended and self._oldest_is_next else None
                self._granted += 1
            self._waiting.remove(request)
            self._working.append(request)
            return True

    @property
    def _oldest_is_next(self) -> bool:
        return self._granted % OLDEST_EVERY == OLDEST_EVERY - 1

    def _may(self, request: Request) -> bool:
        if any(other.isolated for other in self._working):
            return False
        first_isolated = next((other for other in self._waiting if other.isolated), None)
        if first_isolated is not None:  # or it might never find the others at rest
            return request is first_isolated and not self._working
        if request.left is None:
            return True
        return all(other.left is None for other in self._working) and request is self._next()

    def _next(self) -> Request:
        tiles = [request for request in self._waiting if request.left is not None]
        if self._oldest_is_next:
            return min(tiles, key=lambda request: request.submitted)
        return min(tiles, key=lambda request: (request.left, request.submitted))
