"""The objects that the workflows of one worker process share."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import sqlalchemy as sa

from ..jobs.attempts import Attempts
from ..jobs.job import Job
from ..jobs.shards import Shards
from ..jobs.worker_registry import Workers
from ..settings import Settings
from ..storage.base import Storage
from ..telemetry import logs, tracing
from .cloud_cache import CloudCache, PreparedCloud
from .in_flight import InFlight
from .metrics import WorkerMetrics
from .model_cache import ModelCache
from .peers import Peers
from .scheduler import Scheduler
from .speeds import Speeds


class Runtime:
    """The parts of a worker, and the few things that take several of them.

    Parameters
    ----------
    settings : Settings
    storage : Storage
    engine : sqlalchemy.Engine
        Of the job database.
    models : ModelCache
    scheduler : Scheduler

    Attributes
    ----------
    attempts, shards : Attempts, Shards
        The tables that hold the leases and the progress of jobs and of shards.
    metrics : WorkerMetrics
    speeds : Speeds
    clouds : CloudCache
    in_flight : InFlight
    peers : Peers
    """

    def __init__(
        self, settings: Settings, storage: Storage, engine: sa.Engine, models: ModelCache, scheduler: Scheduler
    ) -> None:
        self.settings = settings
        self.storage = storage
        self.engine = engine
        self.models = models
        self.scheduler = scheduler
        self.attempts = Attempts(engine, settings.job_ttl)
        self.shards = Shards(engine)
        self.metrics = WorkerMetrics()
        self.speeds = Speeds()
        self.clouds: CloudCache[PreparedCloud] = CloudCache()
        self.in_flight = InFlight()
        self.peers = Peers(models, Workers(engine), settings)

    def record(self, job: Job) -> Attempts | Shards:
        """Return the table of the lease and progress of `job`: its own row, or that of a shard."""
        return self.attempts if job.shard is None else self.shards

    @contextmanager
    def working_on(self, work: str, job_id: str) -> Iterator[None]:
        """Run the workflow of a job, or of a shard of `job_id`."""
        is_shard = work != job_id
        record = self.shards if is_shard else self.attempts
        with self.clouds.used_by(job_id, is_shard=is_shard), self.in_flight.running(work, record):
            yield

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
        """Compute for a job as soon as the scheduler grants it; while it waits its lease is released.

        Parameters
        ----------
        job : Job
        check : callable
            Called every second while the job waits; raises once the job is cancelled.
        left : int, optional
            Points that the job still has to do, for a tile. None for work beside the tiles of other jobs.

        Yields
        ------
        callable
            To be called between two batches: lets tiles of smaller jobs go first, and returns the seconds they took.
        """

        def poll() -> None:
            self.in_flight.pause_if_stopping(job.work)
            check()

        with self.scheduler.work(
            job.id,
            submitted=job.created_at,
            left=left,
            isolated=job.crashes > 0,
            waits=lambda: self.record(job).release(job.work),  # should the process crash now, it was not this job
            poll=poll,
        ) as grant:

            def reacquire_after(waited: bool) -> None:
                if waited:
                    self.record(job).reacquire(job.work)

            def yield_to_smaller() -> float:
                began = time.monotonic()
                reacquire_after(waited := grant.yield_to_smaller())
                return time.monotonic() - began if waited else 0.0

            reacquire_after(grant.waited)
            yield yield_to_smaller

    def stop(self) -> None:
        """Let the work in flight reach its next safe point, and begin nothing new."""
        self.in_flight.stop()
        self.scheduler.close()


_runtime: Runtime | None = None


def install(runtime: Runtime) -> None:
    """Set the runtime of this process, once, before the job engine is launched."""
    global _runtime
    _runtime = runtime


def runtime() -> Runtime:
    """Return the runtime of this process: the job engine calls workflows with plain data only."""
    assert _runtime is not None
    return _runtime
