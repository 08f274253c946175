"""The loop of a worker: load the model, join the queues, and look after them until the process stops."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial

import numba
import sqlalchemy as sa
import torch

from ..database.damage import SENTENCES, damage_of
from ..jobs.retention import Retention
from ..jobs.store import Jobs
from ..jobs.worker_registry import Workers
from ..problems import Problem
from ..settings import Settings
from ..storage.open import open_storage
from . import workflow  # noqa: F401  (registers the workflows with the job engine)
from .callbacks import queue_due
from .context import Runtime, install
from .heartbeat import Heartbeat
from .model_cache import ModelCache
from .recovery import fail_given_up, launch, take_over
from .scheduler import Scheduler

log = logging.getLogger("service.worker")

LOOK_SECONDS = 0.5
PURGE_SECONDS = 60.0
STORAGE_SECONDS = 180.0  # that a step waits for a storage that does not answer, three times


class Loop:
    """A worker at work.

    Parameters
    ----------
    settings : Settings
    engine : sqlalchemy.Engine
        Of the job database.
    workers : Workers
    heartbeat : Heartbeat
        Reports the state of this worker.
    threads : int
        Of torch; Numba has read its own from the environment.

    Raises
    ------
    SettingsError, PcdnfError, StorageError
        If storage, model or device cannot be used.
    """

    def __init__(
        self, settings: Settings, engine: sa.Engine, workers: Workers, heartbeat: Heartbeat, threads: int
    ) -> None:
        torch.set_num_threads(threads)
        self._settings, self._engine, self._workers, self._heartbeat = settings, engine, workers, heartbeat
        self._runtime = _load(settings, engine, heartbeat)
        storage = self._runtime.storage
        self._retention = Retention(engine, storage, Jobs(engine, storage, settings), settings)
        self._recovered = self._purged = 0.0

    def run(self, stopping: threading.Event, *, last_write: Callable[[Callable[[], None]], None]) -> None:
        """Take jobs until `stopping` is set, then let those in flight reach a safe point within the grace period.

        Parameters
        ----------
        stopping : threading.Event
        last_write : callable
            Makes a write to the job database that may be given up.
        """
        settings, heartbeat, runtime = self._settings, self._heartbeat, self._runtime
        if stopping.is_set():
            return
        launch(settings, self._engine)
        heartbeat.metrics = partial(runtime.metrics.text, runtime.models.device)
        heartbeat.state = "ready"
        heartbeat.beat()
        log.info("worker %s ready on %s", settings.executor_id, runtime.models.device)
        while not stopping.is_set():  # not stopping.wait(): a signal's handler sets it in this same thread
            time.sleep(LOOK_SECONDS)
            heartbeat.job, heartbeat.points_per_second = runtime.scheduler.computing, runtime.speeds.newest
            try:
                self._look_after_the_queues()
            except Exception as error:
                damage = damage_of(error)
                if damage is None:
                    log.exception("looking after the queues failed; trying again")
                else:
                    log.error("%s Run `pcdnf doctor`.", SENTENCES[damage])
        runtime.stop()
        deadline = time.monotonic() + settings.grace_seconds
        heartbeat.state = "stopping"
        last_write(heartbeat.beat)
        while not runtime.in_flight.at_rest and time.monotonic() < deadline:
            time.sleep(0.05)
        last_write(runtime.in_flight.release_rest)

    def _look_after_the_queues(self) -> None:
        """Recover the work of lost workers, free idle clouds, and remove what has expired, each when it is due."""
        if self._settings.callback_host_names:
            queue_due(self._engine)
        if time.monotonic() - self._recovered > self._settings.heartbeat_seconds:
            self._recovered = time.monotonic()
            take_over(self._settings, self._workers)
            fail_given_up(self._runtime.attempts)
            self._runtime.clouds.remove_idle()
        if time.monotonic() - self._purged > min(PURGE_SECONDS, self._settings.job_ttl):
            self._purged = time.monotonic()
            self._retention.purge()
            with suppress(Problem):  # nothing is left that might be removed
                self._retention.make_room()


def _load(settings: Settings, engine: sa.Engine, heartbeat: Heartbeat) -> Runtime:
    """Open the storage, load and warm the default model, and install the runtime of this process."""
    storage = open_storage(settings, patience=STORAGE_SECONDS)
    storage.check()
    models = ModelCache(settings)
    heartbeat.details = models.execution(settings.default_model)
    one_caller = numba.threading_layer() == "workqueue"  # type: ignore[attr-defined]
    runtime = Runtime(settings, storage, engine, models, Scheduler(always_isolated=one_caller))
    install(runtime)
    return runtime
