"""What one worker process shares between its main thread and the workflows it runs."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from . import logs, tracing
from .attempts import Attempts
from .job import Job
from .measures import Measures
from .models import Models
from .settings import Settings
from .storage import Storage
from .turns import Turns

SPEED_WEIGHT = 0.3  # of the newest tile in the moving average


class Runtime:
    """Settings, storage, models, and the jobs that this worker has in hand.

    Attributes
    ----------
    kept : dict of str to object
        What each job's workflow keeps in memory between two tiles; dropped with the job.
    in_hand, parked : set of str
        The jobs whose workflows run, and those that were let go of because this process stops.
    turns : Turns
        Who of them may compute.
    measures : Measures
    """

    def __init__(self, settings: Settings, storage: Storage, attempts: Attempts, models: Models, turns: Turns) -> None:
        self.settings = settings
        self.storage = storage
        self.attempts = attempts
        self.models = models
        self.turns = turns
        self.measures = Measures()
        self.kept: dict[str, Any] = {}
        self.in_hand: set[str] = set()
        self.parked: set[str] = set()
        self._speeds: dict[str, float] = {}
        self._newest: str | None = None
        self._stopping = threading.Event()

    @contextmanager
    def working_on(self, job_id: str) -> Iterator[None]:
        """Mark the job as in hand."""
        self.in_hand.add(job_id)
        try:
            self.pause_if_stopping(job_id)
            yield
        finally:
            self.kept.pop(job_id, None)
            self.in_hand.discard(job_id)

    @contextmanager
    def attempt(self, job: Job) -> Iterator[None]:
        """Work through a job, in the trace and with the request id of the request that made it."""
        if job.execution is None and job.started_at is not None:
            self.measures.waited((job.started_at - job.created_at) / 1000)
        context = job.context or {}
        request_id = {name: value for name, value in context.items() if name == "request_id"}
        with logs.about(job_id=job.id, **request_id), tracing.span("job", carrier=context) as span:
            span.set_attribute("pcdnf.job.id", job.id)
            yield

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time a stage of a job, one of :data:`service.measures.STAGES`."""
        with tracing.span(name), self.measures.stage(name):
            yield

    @contextmanager
    def at_work(
        self, job: Job, wanted: Callable[[], None], *, left: int | None = None
    ) -> Iterator[Callable[[], float]]:
        """Work on a job: a tile with `left` points to do, or something that needs no turn.

        Parameters
        ----------
        job : Job
        wanted : callable
            Called now and then while the job waits; raises where it is not wanted any more.
        left : int, optional

        Yields
        ------
        callable
            To be called between two batches: lets tiles of smaller jobs go first, and returns the seconds they took.
        """

        def poll() -> None:
            self.pause_if_stopping(job.id)
            wanted()

        with self.turns.work(
            job.id,
            submitted=job.created_at,
            left=left,
            alone=job.losses > 0,
            waits=lambda: self.attempts.park(job.id),  # should the process die now, this job is not to blame
            poll=poll,
        ) as turn:

            def resume(waited: bool) -> None:
                if waited:
                    self.attempts.update(job.id, open=True)

            def give_way() -> float:
                began = time.monotonic()
                resume(waited := turn.give_way())
                return time.monotonic() - began if waited else 0.0

            resume(turn.waited)
            yield give_way

    def stop(self) -> None:
        """Let the jobs in hand come to rest after what they are at."""
        self._stopping.set()
        self.turns.close()

    @property
    def at_rest(self) -> bool:
        """Whether every job in hand was let go of."""
        return self.in_hand <= self.parked

    def pause_if_stopping(self, job_id: str) -> None:
        """Let go of the job and wait for the end of this process, if that is near."""
        if self._stopping.is_set():
            self.attempts.park(job_id)
            self.parked.add(job_id)
            threading.Event().wait()

    @property
    def points_per_second(self) -> float | None:
        """Moving average over the tiles of the model used last."""
        return None if self._newest is None else self._speeds[self._newest]

    def speed(self, form: str) -> float | None:
        """Return the moving average over the tiles of a form of a model, in points per second."""
        return self._speeds.get(form)

    def measured(self, form: str, points: int, seconds: float) -> None:
        """Take a finished tile into the average speed."""
        speed = points / max(seconds, 1e-6)
        before = self._speeds.get(form, speed)
        self._speeds[form] = before + SPEED_WEIGHT * (speed - before)
        self._newest = form
