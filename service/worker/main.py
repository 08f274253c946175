"""The worker process: take the slot of its name, send heartbeats, run jobs until SIGTERM, and leave in good order."""

from __future__ import annotations

import logging
import os
import signal
import threading
from collections.abc import Callable
from types import FrameType
from typing import NoReturn

import sqlalchemy as sa
from sqlalchemy.exc import SQLAlchemyError

from pcdnf.errors import PcdnfError

from ..database.engine import create_engine
from ..jobs.worker_registry import Workers
from ..settings import Settings, SettingsError
from ..startup import load_settings, make_data_dir, observe, refuse, upgrade_database
from ..storage.base import StorageError
from ..supervision import EX_CONFIG, end_with_supervisor, say_refusal
from ..telemetry import tracing
from .heartbeat import Heartbeat
from .slot import SlotTakenError, take_slot

log = logging.getLogger("service.worker")  # not __main__

LAST_SECONDS = 2.0  # for each of the last writes of a worker that stops; its supervisor waits no longer
LEAVE_SECONDS = 1.0  # the same for a worker that stops before it was ready


class Stop:
    """The signals that ask this process to stop: at a safe point if it takes jobs, at once while it still starts.

    Attributes
    ----------
    wanted : threading.Event
    takes_jobs : bool
    leave : callable
        Leaves the table of workers; called if the process stops while it starts.
    """

    def __init__(self) -> None:
        self.wanted = threading.Event()
        self.takes_jobs = False
        self.leave: Callable[[], None] = lambda: None
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._on_signal)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:  # noqa: ARG002
        self.wanted.set()
        if not self.takes_jobs:  # it loads libraries and a model, which takes long, and has nothing to finish
            with_time_limit(self.leave, LEAVE_SECONDS)
            os._exit(0)


def main() -> NoReturn:
    """Run jobs until SIGTERM or SIGINT; a tile that is being computed is finished and checkpointed first."""
    settings = load_settings()
    make_data_dir(settings)
    observe(settings, "pcdnf-worker")
    stop = Stop()
    end_with_supervisor()
    try:
        slot = take_slot(settings)
    except SlotTakenError as error:
        refuse(str(error))
    upgrade_database(settings)
    engine = create_engine(settings)
    workers = Workers(engine)
    uses_server = not settings.resolved_database_url.startswith("sqlite")  # on SQLite the slot's lock is enough
    if uses_server and workers.beats_elsewhere(settings.executor_id, settings.heartbeat_seconds):
        refuse(
            f"A worker named {settings.executor_id} is running on another machine. "
            "Set PCDNF_WORKER_ID to another name for this one."
        )
    heartbeat = Heartbeat(workers, settings)
    stop.leave = heartbeat.stop
    heartbeat.start()
    status = _run(settings, engine, workers, heartbeat, stop)
    try:
        with_time_limit(heartbeat.stop)
        slot.close()
        tracing.close()
        logging.shutdown()
    finally:
        os._exit(status)  # paused workflows wait for this in threads of their own


def limit_threads(settings: Settings) -> int:
    """Set the threads of torch and Numba, before they are imported, and return how many."""
    threads = settings.threads or len(
        os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else range(os.cpu_count() or 1)
    )
    for variable in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ[variable] = str(threads)
    return threads


def with_time_limit(write: Callable[[], None], seconds: float = LAST_SECONDS) -> None:
    """Make one of the last writes to the database, but give up after some seconds if it does not answer."""

    def attempt() -> None:
        try:
            write()
        except SQLAlchemyError as error:
            log.warning("the job database did not take the last write of this worker: %s", type(error).__name__)

    thread = threading.Thread(target=attempt, daemon=True)
    thread.start()
    thread.join(seconds)


def _run(settings: Settings, engine: sa.Engine, workers: Workers, heartbeat: Heartbeat, stop: Stop) -> int:
    """Run the loop of the worker and return the exit status of the process."""
    threads = limit_threads(settings)
    from .loop import Loop  # imports torch and Numba, which read the environment then

    try:
        loop = Loop(settings, engine, workers, heartbeat, threads)
        stop.takes_jobs = True
        loop.run(stop.wanted, last_write=with_time_limit)
        log.info("worker %s stops", settings.executor_id)
        return 0
    except SettingsError as error:
        say_refusal(str(error))
        return EX_CONFIG
    except PcdnfError as error:
        say_refusal(f"{error} {error.hint or ''}".rstrip())
        return EX_CONFIG
    except StorageError as error:
        log.error("worker %s cannot reach the storage: %s", settings.executor_id, error)
    except Exception:
        log.exception("worker %s fails", settings.executor_id)
    return 1
