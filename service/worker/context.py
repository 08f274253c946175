"""What one worker process shares between its main thread and the workflows it runs."""

from __future__ import annotations

import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa

from ..jobs.attempts import Attempts
from ..jobs.job import Job
from ..jobs.shards import Shards
from ..jobs.worker_registry import Workers
from ..settings import Settings
from ..storage.base import Storage
from ..telemetry import logs, tracing
from .metrics import WorkerMetrics
from .model_cache import ModelCache
from .scheduler import Scheduler

SPEED_WEIGHT = 0.3  # of the newest tile in the moving average
IDLE_SECONDS = 30.0  # that a prepared cloud is kept after its last shard


@dataclass(frozen=True)
class Held:
    """A job or a shard in hand: of which job, and where it is put down."""

    job: str
    record: Attempts | Shards


class Runtime:
    """Settings, storage, models, and the jobs that this worker has in hand.

    Attributes
    ----------
    cached : dict of str to object
        What is kept in memory of each job between two tiles.
    in_hand : dict of str to Held
        The jobs and shards whose workflows run.
    parked : set of str
        Those that were let go of because this process stops.
    scheduler : Scheduler
        Who of them may compute.
    metrics : WorkerMetrics
    """

    def __init__(
        self, settings: Settings, storage: Storage, engine: sa.Engine, models: ModelCache, scheduler: Scheduler
    ) -> None:
        self.settings = settings
        self.storage = storage
        self.engine = engine
        self.attempts = Attempts(engine, settings.job_ttl)
        self.shards = Shards(engine)
        self.models = models
        self.scheduler = scheduler
        self.metrics = WorkerMetrics()
        self.cached: dict[str, Any] = {}
        self.in_hand: dict[str, Held] = {}
        self._workers = Workers(engine)
        self._idle: dict[str, float] = {}
        self._preparing: defaultdict[str, threading.Lock] = defaultdict(threading.Lock)
        self.parked: set[str] = set()
        self._speeds: dict[str, float] = {}
        self._newest: str | None = None
        self._stopping = threading.Event()

    @contextmanager
    def working_on(self, work: str, job_id: str, record: Attempts | Shards) -> Iterator[None]:
        """Mark a job, or a shard of `job_id`, as in hand."""
        self.in_hand[work] = Held(job_id, record)
        try:
            self.pause_if_stopping(work)
            yield
        finally:
            del self.in_hand[work]
            if work == job_id:
                self._drop(job_id)
            else:
                self._idle[job_id] = time.monotonic()  # the next shard may come in a moment

    def drop_idle(self, seconds: float = IDLE_SECONDS) -> None:
        """Drop what is kept of jobs whose last shard was given back so many seconds ago."""
        busy = {held.job for held in list(self.in_hand.values())}
        for job_id, since in list(self._idle.items()):
            if job_id not in busy and time.monotonic() - since > seconds:
                self._drop(job_id)

    def _drop(self, job_id: str) -> None:
        for cache in (self.cached, self._idle, self._preparing):
            cache.pop(job_id, None)

    @contextmanager
    def preparing(self, job: Job, poll: Callable[[], None]) -> Iterator[None]:
        """Prepare the cloud of a job while no other shard of it does the same."""
        lock = self._preparing[job.id]
        while not lock.acquire(timeout=1.0):
            poll()
        try:
            yield
        finally:
            lock.release()

    def record(self, job: Job) -> Attempts | Shards:
        """Return where the work on `job` is put down: in its own row, or in that of a shard."""
        return self.attempts if job.shard is None else self.shards

    def computes_alike(self, job: Job) -> bool:
        """Return whether this worker computes as the one that `job` began on."""
        return _kind(self.models.execution(job.parameters["model"])) == _kind(job.execution or {})

    def has_peers(self) -> bool:
        """Return whether there are other workers, and all of them like this one."""
        mine = _kind(self.models.execution(self.settings.default_model))
        ready = [each for each in self._workers.alive(self.settings.ready_stale_seconds) if each.state == "ready"]
        return len(ready) > 1 and all(_kind(each.details) == mine for each in ready)

    @contextmanager
    def attempt(self, job: Job) -> Iterator[None]:
        """Work through a job, in the trace and with the request id of the request that made it."""
        if job.execution is None and job.started_at is not None:
            self.metrics.waited((job.started_at - job.created_at) / 1000)
        context = job.context or {}
        request_id = {name: value for name, value in context.items() if name == "request_id"}
        with logs.about(job_id=job.id, **request_id), tracing.span("job", carrier=context) as span:
            span.set_attribute("pcdnf.job.id", job.id)
            yield

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time a stage of a job, one of :data:`service.worker.metrics.STAGES`."""
        with tracing.span(name), self.metrics.stage(name):
            yield

    @contextmanager
    def at_work(self, job: Job, check: Callable[[], None], *, left: int | None = None) -> Iterator[Callable[[], float]]:
        """Work on a job: a tile with `left` points to do, or something that needs no turn.

        Parameters
        ----------
        job : Job
        check : callable
            Called now and then while the job waits; raises where it is not wanted any more.
        left : int, optional

        Yields
        ------
        callable
            To be called between two batches: lets tiles of smaller jobs go first, and returns the seconds they took.
        """

        def poll() -> None:
            self.pause_if_stopping(job.work)
            check()

        with self.scheduler.work(
            job.id,
            submitted=job.created_at,
            left=left,
            alone=job.crashes > 0,
            waits=lambda: self.record(job).release(job.work),  # should the process die now, this job is not to blame
            poll=poll,
        ) as turn:

            def resume(waited: bool) -> None:
                if waited:
                    self.record(job).reacquire(job.work)

            def yield_to_smaller() -> float:
                began = time.monotonic()
                resume(waited := turn.yield_to_smaller())
                return time.monotonic() - began if waited else 0.0

            resume(turn.waited)
            yield yield_to_smaller

    def stop(self) -> None:
        """Let the jobs in hand come to rest after what they are at."""
        self._stopping.set()
        self.scheduler.close()

    @property
    def at_rest(self) -> bool:
        """Whether everything in hand was let go of."""
        return self.in_hand.keys() <= self.parked

    def pause_if_stopping(self, work: str) -> None:
        """Let go of a job or shard in hand and wait for the end of this process, if that is near."""
        if self._stopping.is_set():
            self._let_go(work)
            threading.Event().wait()

    def let_go_of_the_rest(self) -> None:
        """Let go of what could not come to rest in time."""
        for work in self.in_hand.keys() - self.parked:
            self._let_go(work)

    def _let_go(self, work: str) -> None:
        held = self.in_hand.get(work)
        if held is not None:  # it has not ended meanwhile
            held.record.release(work)
            self.parked.add(work)

    @property
    def points_per_second(self) -> float | None:
        """Moving average over the tiles of the model used last."""
        return None if self._newest is None else self._speeds[self._newest]

    def speed(self, key: str) -> float | None:
        """Return the moving average over the tiles of a form of a model, in points per second."""
        return self._speeds.get(key)

    def measured(self, key: str, points: int, seconds: float) -> None:
        """Take a finished tile into the average speed."""
        speed = points / max(seconds, 1e-6)
        before = self._speeds.get(key, speed)
        self._speeds[key] = before + SPEED_WEIGHT * (speed - before)
        self._newest = key


def _kind(execution: dict[str, Any]) -> tuple[Any, ...]:
    """Return what the bits of a result depend on, as far as a worker knows it."""
    return (str(execution.get("device")).partition(":")[0], execution.get("precision"), execution.get("version"))
