"""The worker process: ``python -m service.worker``. It takes jobs off the queues and runs them, tile by tile."""

from __future__ import annotations

import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial

import sqlalchemy as sa
from sqlalchemy.exc import SQLAlchemyError

from pcdnf.errors import PcdnfError

from ..database.engine import create_engine
from ..database.migrations import migrate
from ..jobs.retention import Retention
from ..jobs.store import Jobs
from ..jobs.worker_registry import Workers
from ..problems import Problem
from ..settings import Settings, SettingsError
from ..startup import load_settings, make_data_dir, observe, refuse
from ..storage.base import StorageError
from ..storage.open import open_storage
from ..supervision import EX_CONFIG, end_with_supervisor
from ..telemetry import tracing
from .heartbeat import Heartbeat
from .recovery import fail_given_up, launch, take_over
from .slot import SlotTakenError, take_slot

log = logging.getLogger("service.worker")  # not __main__

PURGE_SECONDS = 60.0
STORAGE_SECONDS = 180.0  # that a step waits for a storage that does not answer, three times
LAST_SECONDS = 2.0  # for each of the last writes of a worker that stops; its supervisor waits no longer


def limit_threads(settings: Settings) -> int:
    """Set the threads of torch and Numba, once and before they are imported; return how many."""
    threads = settings.threads or len(
        os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else range(os.cpu_count() or 1)
    )
    for variable in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ[variable] = str(threads)
    return threads


def main() -> None:
    """Run jobs until SIGTERM or SIGINT; the tile in hand is finished and checkpointed first."""
    settings = load_settings()
    make_data_dir(settings)
    observe(settings, "pcdnf-worker")
    stopping = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stopping.set())
    end_with_supervisor()
    try:
        slot = take_slot(settings)
    except SlotTakenError:
        refuse(f"Another worker named {settings.executor_id} is running on {settings.data_dir}. Set PCDNF_WORKER_ID.")
    migrate(settings)
    engine = create_engine(settings)
    workers = Workers(engine)
    shared = not settings.resolved_database_url.startswith("sqlite")  # else the lock says it all
    if shared and workers.beats_elsewhere(settings.executor_id, settings.heartbeat_seconds):
        refuse(f"A worker named {settings.executor_id} is running on another machine. Set PCDNF_WORKER_ID.")
    heartbeat = Heartbeat(workers, settings)
    heartbeat.start()
    status = 0
    try:
        serve(settings, engine, workers, heartbeat, stopping)
        log.info("worker %s stops", settings.executor_id)
    except SettingsError as error:
        status = EX_CONFIG
        print(f"pcdnf: {error}", file=sys.stderr)
    except PcdnfError as error:
        status = EX_CONFIG
        print(f"pcdnf: {error} {error.hint or ''}".rstrip(), file=sys.stderr)
    except StorageError as error:
        status = 1
        log.error("worker %s cannot reach the storage: %s", settings.executor_id, error)
    except Exception:
        status = 1
        log.exception("worker %s fails", settings.executor_id)
    try:
        with_time_limit(heartbeat.stop)
        slot.close()
        tracing.close()
        logging.shutdown()
    finally:
        os._exit(status)  # a parked workflow waits in its thread for this


def with_time_limit(write: Callable[[], None]) -> None:
    """Do one of the last writes to the database, but leave it where that does not answer: this process ends."""

    def attempt() -> None:
        try:
            write()
        except SQLAlchemyError as error:
            log.warning("the job database did not take leave of this worker: %s", type(error).__name__)

    thread = threading.Thread(target=attempt, daemon=True)
    thread.start()
    thread.join(LAST_SECONDS)


def serve(
    settings: Settings, engine: sa.Engine, workers: Workers, heartbeat: Heartbeat, stopping: threading.Event
) -> None:
    """Load the model, join the queue, and look after it until `stopping` is set.

    Raises
    ------
    PcdnfError
        If the model or the device cannot be used.
    """
    threads = limit_threads(settings)
    import numba
    import torch

    from . import workflow
    from .context import Runtime
    from .model_cache import ModelCache
    from .scheduler import Scheduler

    torch.set_num_threads(threads)
    storage = open_storage(settings, patience=STORAGE_SECONDS)
    storage.check()
    models = ModelCache(settings)
    heartbeat.details = models.execution(settings.default_model)
    one_caller = numba.threading_layer() == "workqueue"  # type: ignore[attr-defined]
    runtime = Runtime(settings, storage, engine, models, Scheduler(always_alone=one_caller))
    workflow.install(runtime)
    retention = Retention(engine, storage, Jobs(engine, storage, settings), settings)
    if stopping.is_set():
        return
    launch(settings, engine)
    heartbeat.metrics = partial(runtime.metrics.text, models.device)
    heartbeat.state = "ready"
    heartbeat.beat()
    log.info("worker %s ready on %s", settings.executor_id, models.device)
    recovered = purged = 0.0
    while not stopping.is_set():  # not stopping.wait(): the handler of a signal sets it in this same thread
        time.sleep(0.5)
        heartbeat.job, heartbeat.points_per_second = runtime.scheduler.computing, runtime.points_per_second
        try:
            if time.monotonic() - recovered > settings.heartbeat_seconds:
                recovered = time.monotonic()
                take_over(settings, workers)
                fail_given_up(runtime.attempts)
                runtime.drop_idle()
            if time.monotonic() - purged > min(PURGE_SECONDS, settings.job_ttl):
                purged = time.monotonic()
                retention.purge()
                with suppress(Problem):  # nothing is left that might go
                    retention.make_room()
        except Exception:
            log.exception("looking after the queue failed; trying again")
    runtime.stop()
    deadline = time.monotonic() + settings.grace_seconds
    heartbeat.state = "stopping"
    with_time_limit(heartbeat.beat)
    while not runtime.at_rest and time.monotonic() < deadline:
        time.sleep(0.05)
    with_time_limit(runtime.let_go_of_the_rest)
