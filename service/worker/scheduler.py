"""Which of the jobs in hand computes: one tile at a time, of the job with the least left to do.

A tile that is being computed gives way, between two batches, to one of a job with less left. Every fourth turn goes to
the job that was submitted first, and then it keeps its turn, so that a stream of small ones holds nobody up for good.
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
    waits: Callable[[], None]
    poll: Callable[[], None]


@dataclass(frozen=True)
class Turn:
    """Work that has begun: whether it had to wait, and a way to let others go first, which tells if it did."""

    waited: bool
    give_way: Callable[[], bool]


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
        self._kept: Claim | None = None  # does not give way
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
    ) -> Iterator[Turn]:
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
            Called whenever the job has to wait.
        poll : callable
            Called every second while it waits; may raise to give up.

        Yields
        ------
        Turn
        """
        claim = Claim(job, submitted, left, alone or self._always_alone, waits, poll)
        with self._changed:
            self._waiting.append(claim)
        try:
            yield Turn(self._wait(claim), lambda: self._give_way(claim))
        finally:
            with self._changed:
                (self._working if claim in self._working else self._waiting).remove(claim)
                self._changed.notify_all()

    def _wait(self, claim: Claim) -> bool:
        if self._begin(claim, 0.0):
            return False
        claim.waits()
        while not self._begin(claim, POLL_SECONDS):
            claim.poll()
        return True

    def _give_way(self, claim: Claim) -> bool:
        with self._changed:
            if self._closed or claim is self._kept or any(other.alone for other in (*self._waiting, *self._working)):
                return False
            others = [other.left for other in self._waiting if other.left is not None and other.job != claim.job]
            if all(left >= (claim.left or 0) for left in others):
                return False
            self._working.remove(claim)
            self._waiting.append(claim)
            self._changed.notify_all()
        return self._wait(claim)

    def _begin(self, claim: Claim, seconds: float) -> bool:
        with self._changed:
            if not self._changed.wait_for(lambda: self._closed or self._may(claim), seconds) or self._closed:
                return False
            if claim.left is not None:
                contended = any(other.left is not None for other in self._waiting if other is not claim)
                self._kept = claim if contended and self._oldest_is_next else None
                self._granted += 1
            self._waiting.remove(claim)
            self._working.append(claim)
            return True

    @property
    def _oldest_is_next(self) -> bool:
        return self._granted % OLDEST_EVERY == OLDEST_EVERY - 1

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
        if self._oldest_is_next:
            return min(tiles, key=lambda claim: claim.submitted)
        return min(tiles, key=lambda claim: (claim.left, claim.submitted))
