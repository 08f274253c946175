"""The jobs and shards whose workflows run in this process, and how they are left when it stops."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from ..jobs.attempts import Attempts
from ..jobs.shards import Shards


class InFlight:
    """Work in flight, by the id of the job or shard.

    Attributes
    ----------
    released : set of str
        Work whose lease was released because this process stops. Its workflow waits for the end of the process.
    """

    def __init__(self) -> None:
        self._records: dict[str, Attempts | Shards] = {}
        self.released: set[str] = set()
        self._stopping = threading.Event()

    @contextmanager
    def running(self, work: str, record: Attempts | Shards) -> Iterator[None]:
        """Count a job or shard as in flight, with the table that holds its lease."""
        self._records[work] = record
        try:
            self.pause_if_stopping(work)
            yield
        finally:
            del self._records[work]

    def stop(self) -> None:
        """Let every workflow pause at its next safe point."""
        self._stopping.set()

    @property
    def at_rest(self) -> bool:
        """Whether every lease was released."""
        return self._records.keys() <= self.released

    def pause_if_stopping(self, work: str) -> None:
        """Release the lease and wait for the end of this process, if it stops; never returns then."""
        if self._stopping.is_set():
            self._release(work)
            threading.Event().wait()

    def release_rest(self) -> None:
        """Release the leases of the work that did not reach a safe point in time."""
        for work in self._records.keys() - self.released:
            self._release(work)

    def _release(self, work: str) -> None:
        record = self._records.get(work)
        if record is not None:  # its workflow has not ended meanwhile
            record.release(work)
            self.released.add(work)
