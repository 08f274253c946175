"""Prepared clouds in memory, one a job, between two of its tiles."""

from __future__ import annotations

import threading
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Generic, TypeVar

from pcdnf.denoiser import Cloud, Denoiser

IDLE_SECONDS = 30.0
"""Time that a cloud stays after the last shard of its job: the next shard may follow."""

POLL_SECONDS = 1.0

Item = TypeVar("Item")


@dataclass
class PreparedCloud:
    """The cloud of one iteration, made ready for its tiles; `order` sums up that of its points."""

    iteration: int
    denoiser: Denoiser
    cloud: Cloud
    order: int


class CloudCache(Generic[Item]):
    """The prepared cloud of each job that this worker works on."""

    def __init__(self) -> None:
        self._clouds: dict[str, Item] = {}
        self._users: Counter[str] = Counter()
        self._idle_since: dict[str, float] = {}
        self._preparing: defaultdict[str, threading.Lock] = defaultdict(threading.Lock)

    def get(self, job_id: str) -> Item | None:
        """Return the cloud of a job, or None."""
        return self._clouds.get(job_id)

    def put(self, job_id: str, cloud: Item) -> None:
        """Keep the cloud of a job."""
        self._clouds[job_id] = cloud

    def remove(self, job_id: str) -> None:
        """Free the cloud of a job."""
        self._clouds.pop(job_id, None)

    @contextmanager
    def used_by(self, job_id: str, *, is_shard: bool) -> Iterator[None]:
        """Keep a job's cloud while its workflow runs, and for a while after that of one of its shards.

        Parameters
        ----------
        job_id : str
        is_shard : bool
            Whether it is the workflow of a shard.
        """
        self._users[job_id] += 1
        try:
            yield
        finally:
            self._users[job_id] -= 1
            if is_shard:
                self._idle_since[job_id] = time.monotonic()
            else:
                self._forget(job_id)

    def remove_idle(self, seconds: float = IDLE_SECONDS) -> None:
        """Free the clouds of jobs whose last shard ended more than `seconds` ago."""
        for job_id, since in list(self._idle_since.items()):
            if not self._users[job_id] and time.monotonic() - since > seconds:
                self._forget(job_id)

    @contextmanager
    def preparing(self, job_id: str, poll: Callable[[], None]) -> Iterator[None]:
        """Prepare the cloud of a job while no other of its shards does the same.

        Parameters
        ----------
        job_id : str
        poll : callable
            Called every second while another one prepares the cloud; may raise to give up.
        """
        lock = self._preparing[job_id]
        while not lock.acquire(timeout=POLL_SECONDS):
            poll()
        try:
            yield
        finally:
            lock.release()

    def _forget(self, job_id: str) -> None:
        for entries in (self._clouds, self._idle_since, self._preparing):
            entries.pop(job_id, None)
        if not self._users[job_id]:
            del self._users[job_id]
