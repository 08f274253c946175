"""What one worker process shares between its main thread and the workflow it runs."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from .attempts import Attempts
from .models import Models
from .settings import Settings
from .storage import Storage

SPEED_WEIGHT = 0.3  # of the newest tile in the moving average


class Runtime:
    """Settings, storage, models, and where this worker is.

    Attributes
    ----------
    kept : object
        What the workflow keeps in memory between two tiles; dropped with the job.
    current : str or None
        The job in hand.
    points_per_second : float or None
        Moving average over tiles.
    stopping, parked : threading.Event
        Set when this process is asked to stop, and when the workflow has let go of its job for that.
    """

    def __init__(self, settings: Settings, storage: Storage, attempts: Attempts, models: Models) -> None:
        self.settings = settings
        self.storage = storage
        self.attempts = attempts
        self.models = models
        self.kept: Any = None
        self.current: str | None = None
        self.points_per_second: float | None = None
        self.stopping = threading.Event()
        self.parked = threading.Event()

    @contextmanager
    def working_on(self, job_id: str) -> Iterator[None]:
        """Mark the job as the one in hand."""
        self.current = job_id
        try:
            self.pause_if_stopping(job_id)
            yield
        finally:
            self.kept = None
            self.current = None

    def pause_if_stopping(self, job_id: str) -> None:
        """Between two tiles: let go of the job and wait for the end of this process, if that is near."""
        if self.stopping.is_set():
            self.attempts.park(job_id)
            self.parked.set()
            threading.Event().wait()

    def measured(self, points: int, seconds: float) -> None:
        """Take a finished tile into the average speed."""
        speed = points / max(seconds, 1e-6)
        before = self.points_per_second
        self.points_per_second = speed if before is None else before + SPEED_WEIGHT * (speed - before)
