"""``pcdnf drain``: stop accepting new jobs, and wait until the accepted ones are finished."""

from __future__ import annotations

import time
from pathlib import Path

import sqlalchemy as sa
from sqlalchemy.exc import SQLAlchemyError

from ..database.damage import DamageError, check_file, damage_of
from ..database.engine import create_engine
from ..database.migrations import lacking, migrate
from ..database.tables import jobs as jobs_table
from ..jobs import drain_switch
from ..jobs.job import LIVE
from ..jobs.worker_registry import Workers
from ..settings import Settings, SettingsError

LOOK_SECONDS, PRINT_SECONDS = 1.0, 10.0


def drain(settings: Settings, *, on: bool | None, wait: bool) -> None:
    """Turn draining on or off, and print the state of the service.

    Parameters
    ----------
    settings : Settings
    on : bool or None
        None changes nothing, neither the switch nor the database.
    wait : bool
        Return only when all jobs are finished, and print their number from time to time.

    Raises
    ------
    SettingsError
        If the job database does not exist, does not answer, or with None is of an older version.
    """
    engine = _open(settings)
    try:
        absent = lacking(engine)
        if absent and on is None:
            raise SettingsError(
                f"The job database has no {absent}. It is empty or of an older version. Start the service once to "
                "upgrade it."
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
        code = damage_of(error)
        if code is not None:
            raise DamageError(code, engine.url.database) from error
        raise SettingsError(
            f"The job database does not answer: {type(error).__name__}. Check PCDNF_DATABASE_URL, and "
            "whether the server runs."
        ) from error
    finally:
        engine.dispose()


def _open(settings: Settings) -> sa.Engine:
    """Return the engine of the job database, which must exist.

    Raises
    ------
    SettingsError
    """
    url = sa.make_url(settings.resolved_database_url)
    if url.get_backend_name() == "sqlite" and not Path(str(url.database)).exists():
        raise SettingsError(
            f"There is no job database at {url.database}. Set PCDNF_DATA_DIR or --data-dir to the "
            "folder of the service."
        )
    check_file(settings, thorough=False)
    return create_engine(settings)


def _state(engine: sa.Engine, settings: Settings) -> tuple[str, int]:
    """Return the state of the service as a line, and the number of unfinished jobs."""
    jobs = jobs_table
    left = sa.func.coalesce(sa.func.sum(jobs.c.total - jobs.c.done), 0)
    with engine.connect() as connection:
        drained = drain_switch.is_on(connection, drain_switch.DRAIN)
        query = sa.select(sa.func.count(), left).where(jobs.c.status.in_(LIVE))
        unfinished, points = map(int, connection.execute(query).one())
    line = "Draining: new jobs are refused." if drained else "Open: new jobs are accepted."
    line += (
        f" Unfinished jobs: {unfinished}, with {points} points times passes."
        if unfinished
        else " All jobs are finished."
    )
    if unfinished and not Workers(engine).alive(settings.worker_stale_seconds):
        line += " No worker is running, so they wait."
    return line, unfinished
