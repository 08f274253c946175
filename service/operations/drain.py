"""``pcdnf drain``: let the service take no new jobs, and wait until it has finished those it has."""

from __future__ import annotations

import time
from pathlib import Path

import sqlalchemy as sa
from sqlalchemy.exc import SQLAlchemyError

from ..database.engine import create_engine
from ..database.migrations import lacking, migrate
from ..database.tables import jobs as jobs_table
from ..jobs import drain_switch
from ..jobs.job import LIVE
from ..jobs.worker_registry import Workers
from ..settings import Settings, SettingsError

LOOK_SECONDS, PRINT_SECONDS = 1.0, 10.0


def drain(settings: Settings, *, on: bool | None, wait: bool) -> None:
    """Turn draining on or off, or leave it and the database as they are with None, and print how the service stands.

    Parameters
    ----------
    settings : Settings
    on : bool or None
    wait : bool
        Come back when no job is unfinished, telling now and then how many are.

    Raises
    ------
    SettingsError
        If there is no job database where the settings say, or, with None, one of an older version.
    """
    engine = _open(settings)
    try:
        absent = lacking(engine)
        if absent and on is None:
            raise SettingsError(
                f"The job database has no {absent}: it is empty, or of an older version, and is upgraded when the "
                "service starts."
            )
        if absent:
            migrate(settings)
        if on is not None:
            with engine.begin() as connection:
                drain_switch.set_switch(connection, drain_switch.DRAIN, on=on)
        printed, before = -PRINT_SECONDS, -1
        while True:
            line, unfinished = _state(engine, settings)
            if unfinished != before or time.monotonic() - printed >= PRINT_SECONDS:
                printed, before = time.monotonic(), unfinished
                print(line, flush=True)
            if not wait or not unfinished:
                return
            time.sleep(LOOK_SECONDS)
    except SQLAlchemyError as error:
        raise SettingsError(f"The job database cannot be reached: {type(error).__name__}.") from error
    finally:
        engine.dispose()


def _open(settings: Settings) -> sa.Engine:
    """Return the engine of the job database; none is made where there is none.

    Raises
    ------
    SettingsError
    """
    url = sa.make_url(settings.resolved_database_url)
    if url.get_backend_name() == "sqlite" and not Path(str(url.database)).exists():
        raise SettingsError(
            f"There is no job database at {url.database}. Set PCDNF_DATA_DIR, or --data-dir, to the service's folder."
        )
    return create_engine(settings)


def _state(engine: sa.Engine, settings: Settings) -> tuple[str, int]:
    """Return how the service stands in a line, and the number of unfinished jobs."""
    jobs = jobs_table
    left = sa.func.coalesce(sa.func.sum(jobs.c.total - jobs.c.done), 0)
    with engine.connect() as connection:
        drained = drain_switch.is_on(connection, drain_switch.DRAIN)
        query = sa.select(sa.func.count(), left).where(jobs.c.status.in_(LIVE))
        unfinished, points = map(int, connection.execute(query).one())
    line = "Drained: no new jobs are taken." if drained else "Open: new jobs are taken."
    line += (
        f" Unfinished jobs: {unfinished}, with {points} points times passes." if unfinished else " None is unfinished."
    )
    if unfinished and not Workers(engine).alive(settings.worker_stale_seconds):
        line += " No worker is running, they wait for one."
    return line, unfinished
