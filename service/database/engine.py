"""Connections to the job database: SQLite by default, or PostgreSQL by URL.

Our tables and those of DBOS are in the same database, so a job and its place in the queue are accepted in one
transaction.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import sqlalchemy as sa

from ..settings import Settings

ADMISSION_LOCK = 7262734  # of PostgreSQL, any number but that of another lock
SQLITE_BUSY_SECONDS = 30.0
IDLE_SECONDS = 10.0  # after which PostgreSQL takes its locks from a process that froze in a transaction, or was cut off
CONNECTION: dict[str, int] = {  # to PostgreSQL; without these a lost machine goes unnoticed for hours
    "connect_timeout": 10,  # seconds, as are the keepalives'
    "keepalives_idle": 10,
    "keepalives_interval": 5,
    "keepalives_count": 3,
    "tcp_user_timeout": 20_000,  # milliseconds
}


def create_engine(settings: Settings, *, busy_seconds: float = SQLITE_BUSY_SECONDS, most: int = 10) -> sa.Engine:
    """Return the engine of the job database; nothing is created yet.

    Parameters
    ----------
    settings : Settings
    busy_seconds : float
        How long a statement waits for a lock of SQLite before it fails.
    most : int
        Connections of SQLite at a time.
    """
    url = settings.resolved_database_url
    if not url.startswith("sqlite"):
        given = sa.make_url(url).query  # an operator's own go first
        engine = sa.create_engine(
            url,
            pool_size=10,
            max_overflow=0,
            pool_pre_ping=True,
            connect_args={name: value for name, value in CONNECTION.items() if name not in given},
            hide_parameters=True,
        )

        @sa.event.listens_for(engine, "connect")
        def bound(connection: Any, _record: object) -> None:
            connection.execute(f"SET idle_in_transaction_session_timeout = {int(IDLE_SECONDS * 1000)}")
            connection.commit()

        return engine
    # One writer at a time, and it waits: BEGIN IMMEDIATE takes the lock before the first write, not in its middle.
    engine = sa.create_engine(
        url,
        pool_size=most,
        max_overflow=0,
        connect_args={"timeout": busy_seconds},
        hide_parameters=True,  # errors are logged, and callers' file names are none of the log's affair
    )

    @sa.event.listens_for(engine, "handle_error")
    def full(context: sa.engine.ExceptionContext) -> None:
        if getattr(context.original_exception, "sqlite_errorcode", None) == sqlite3.SQLITE_FULL:
            context.is_disconnect = True  # as a database that is away, for which the engine waits

    @sa.event.listens_for(engine, "connect")
    def prepare(connection: sqlite3.Connection, _record: object) -> None:
        connection.isolation_level = "IMMEDIATE"
        connection.execute(f"PRAGMA busy_timeout={int(busy_seconds * 1000)}")
        connection.execute("PRAGMA foreign_keys=ON")
        connection.execute("PRAGMA synchronous=FULL")  # an accepted job survives a power loss

    return engine


@contextmanager
def exclusive(connection: sa.Connection) -> Iterator[None]:
    """Run a transaction that no other one of this kind overlaps: what it reads stays true until it has written."""
    with connection.begin():
        # The driver of SQLite begins a transaction at the first write only, and what was read before may be old.
        begin = {"sqlite": "BEGIN IMMEDIATE", "postgresql": f"SELECT pg_advisory_xact_lock({ADMISSION_LOCK})"}
        connection.exec_driver_sql(begin[connection.dialect.name])
        yield
