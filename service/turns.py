"""Which of the jobs in hand computes: one tile at a time, of the job with the least left to do.

Every fourth turn goes to the job that was submitted first, so that a stream of small ones holds nobody up for good.
Reading, preparing, merging and writing need no turn. A job during which the process died before works alone, so that a
second death tells whose fault it was.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

OLDEST_EVERY = 4
POLL_SECONDS = 1.0


@dataclass(frozen=True, eq=False)
class Claim:
    """A job that works, or waits to: for a turn where `left` tells its points still to do, else beside others."""

    job: str
    submitted: int
    left: int | None
    alone: bool


class Turns:
    """Shared by the workflows of one worker.

    Parameters
    ----------
    always_alone : bool
        No two jobs at the same time, whatever they do; where a library bears only one caller.
    """

    def __init__(self, *, always_alone: bool = False) -> None:
        self._always_alone = always_alone
        self._changed = threading.Condition()
        self._waiting: list[Claim] = []
        self._working: list[Claim] = []
        self._granted = 0
        self._closed = False

    @property
    def computing(self) -> str | None:
        """The job whose tile is being computed."""
        return next((claim.job for claim in list(self._working) if claim.left is not None), None)

    def close(self) -> None:
        """Let nobody begin any more; what works goes on to its end."""
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
        alone: bool = False,
        waits: Callable[[], None],
        poll: Callable[[], None],
    ) -> Iterator[bool]:
        """Work on a job, as soon as it may.

        Parameters
        ----------
        job : str
        submitted : int
            When, to find the oldest.
        left : int, optional
            Points still to do; for a tile, which takes a turn.
        alone : bool
            While no other job works.
        waits : callable
            Called once if the job has to wait.
        poll : callable
            Called every second while it waits; may raise to give up.

        Yields
        ------
        bool
            Whether it had to wait.
        """
        claim = Claim(job, submitted, left, alone or self._always_alone)
        with self._changed:
            self._waiting.append(claim)
        try:
            waited = not self._begin(claim, 0.0)
            if waited:
                waits()
                while not self._begin(claim, POLL_SECONDS):
                    poll()
            yield waited
        finally:
            with self._changed:
                (self._working if claim in self._working else self._waiting).remove(claim)
                self._changed.notify_all()

    def _begin(self, claim: Claim, seconds: float) -> bool:
        with self._changed:
            if not self._changed.wait_for(lambda: self._closed or self._may(claim), seconds) or self._closed:
                return False
            self._waiting.remove(claim)
            self._working.append(claim)
            self._granted += claim.left is not None
            return True

    def _may(self, claim: Claim) -> bool:
        if any(other.alone for other in self._working):
            return False
        first_alone = next((other for other in self._waiting if other.alone), None)
        if first_alone is not None:  # or it might never find the others at rest
            return claim is first_alone and not self._working
        if claim.left is None:
            return True
        return all(other.left is None for other in self._working) and claim is self._next()

    def _next(self) -> Claim:
        tiles = [claim for claim in self._waiting if claim.left is not None]
        if self._granted % OLDEST_EVERY == OLDEST_EVERY - 1:
            return min(tiles, key=lambda claim: claim.submitted)
        return min(tiles, key=lambda claim: (claim.left, claim.submitted))
