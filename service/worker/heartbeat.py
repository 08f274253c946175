"""The heartbeat of a worker: a thread that updates its row in the table of workers."""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable

from ..database.damage import SENTENCES, damage_of
from ..jobs.worker_registry import Workers
from ..settings import Settings

log = logging.getLogger(__name__)


class Heartbeat:
    """Reports this worker to the table of workers, from a separate thread."""

    def __init__(self, workers: Workers, settings: Settings) -> None:
        self._workers, self._settings = workers, settings
        self._stop = threading.Event()
        self._lock = threading.Lock()
        self.state = "starting"
        self.details: dict[str, object] = {}
        self.job: str | None = None
        self.points_per_second: float | None = None
        self.metrics: Callable[[], str] | None = None
        self._thread = threading.Thread(target=self._run, name="heart", daemon=True)

    def start(self) -> None:
        """Begin to beat."""
        self.beat()
        self._thread.start()

    def stop(self) -> None:
        """Stop beating and leave the table."""
        self._stop.set()
        if self._thread.ident is not None:  # it has started
            self._thread.join()
        self._workers.leave(self._settings.executor_id)

    def beat(self) -> None:
        """Beat now."""
        with self._lock:
            self._workers.beat(
                self._settings.executor_id,
                pid=os.getpid(),
                state=self.state,
                details=self.details,
                job=self.job,
                points_per_second=self.points_per_second,
                metrics=self.metrics and self.metrics(),
            )

    def _run(self) -> None:
        while not self._stop.wait(self._settings.heartbeat_seconds):
            try:
                self.beat()
            except Exception as error:
                damage = damage_of(error)
                if damage is None:
                    log.exception("the database did not take a heartbeat")
                else:
                    log.error("%s Run `pcdnf doctor`.", SENTENCES[damage])
