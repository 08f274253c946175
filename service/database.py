"""The job database: SQLite by default, PostgreSQL by URL; our own tables beside those of DBOS.

Both kinds of table sit in one database, so that a job and its place in the queue are accepted in one transaction.
"""

from __future__ import annotations

import fcntl
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from dbos import DBOS
from sqlalchemy.ext.compiler import compiles

from .settings import Settings

SQLITE_BUSY_MS = 30_000
IDLE_SECONDS = 10.0  # after which PostgreSQL takes its locks from a process that froze in a transaction, or was cut off
CONNECTION: dict[str, int] = {  # to PostgreSQL, whose end would else go unnoticed for hours where a machine is gone
    "connect_timeout": 10,  # seconds, as are the keepalives'
    "keepalives_idle": 10,
    "keepalives_interval": 5,
    "keepalives_count": 3,
    "tcp_user_timeout": 20_000,  # milliseconds
}
MIGRATION_LOCK, ADMISSION_LOCK = 7262733, 7262734  # of PostgreSQL, any two numbers

metadata = sa.MetaData()

jobs = sa.Table(
    "pcdnf_jobs",
    metadata,
    sa.Column("id", sa.String(64), primary_key=True),
    sa.Column("owner", sa.String(64), nullable=False),
    sa.Column("status", sa.String(16), nullable=False),
    # What was asked for, what was uploaded, on what it runs, what came out; all JSON objects.
    sa.Column("parameters", sa.JSON, nullable=False),
    sa.Column("upload", sa.JSON, nullable=False),
    sa.Column("execution", sa.JSON),
    sa.Column("results", sa.JSON),
    sa.Column("warnings", sa.JSON, nullable=False),
    sa.Column("problem", sa.JSON),
    # Progress in points times iterations.
    sa.Column("done", sa.BigInteger, nullable=False),
    sa.Column("total", sa.BigInteger, nullable=False),
    sa.Column("points_per_second", sa.Float),
    # Milliseconds since 1970, by the clock of the database.
    sa.Column("created_at", sa.BigInteger, nullable=False, index=True),
    sa.Column("started_at", sa.BigInteger),
    sa.Column("finished_at", sa.BigInteger),
    sa.Column("expires_at", sa.BigInteger, index=True),
    sa.Column("purged_at", sa.BigInteger),
    # Whether a worker has it open, and how often one died on it since its last tile.
    sa.Column("open", sa.Boolean, nullable=False),
    sa.Column("losses", sa.Integer, nullable=False),
    # `request_id` and `traceparent` of the request that made the job.
    sa.Column("context", sa.JSON),
    sa.Index("pcdnf_jobs_status_created", "status", "created_at"),
)

workers = sa.Table(
    "pcdnf_workers",
    metadata,
    sa.Column("id", sa.String(64), primary_key=True),
    sa.Column("pid", sa.Integer, nullable=False),
    sa.Column("state", sa.String(16), nullable=False),
    sa.Column("job", sa.String(64)),
    # Device, precision, model, version: what /readyz shows.
    sa.Column("details", sa.JSON, nullable=False),
    sa.Column("points_per_second", sa.Float),
    sa.Column("beat_at", sa.BigInteger, nullable=False),
    # What it measured, as text for Prometheus; see service.metrics.
    sa.Column("metrics", sa.Text),
)

# How many jobs ended how, counted in the transaction that ends them.
outcomes = sa.Table(
    "pcdnf_outcomes",
    metadata,
    sa.Column("outcome", sa.String(16), primary_key=True),
    sa.Column("code", sa.String(64), primary_key=True),  # of the problem, else empty
    sa.Column("jobs", sa.BigInteger, nullable=False),
)

# What an operator has switched on, until it is switched off.
switches = sa.Table(
    "pcdnf_switches",
    metadata,
    sa.Column("name", sa.String(16), primary_key=True),
    sa.Column("since", sa.BigInteger, nullable=False),
)

# Shares of the tiles of one large job, while several workers compute them.
shares = sa.Table(
    "pcdnf_shares",
    metadata,
    sa.Column("id", sa.String(128), primary_key=True),
    sa.Column("job", sa.String(64), sa.ForeignKey("pcdnf_jobs.id", ondelete="CASCADE"), nullable=False, index=True),
    # As the columns of the job, over all iterations: what is done before this share, and of it.
    sa.Column("start", sa.BigInteger, nullable=False),
    sa.Column("done", sa.BigInteger, nullable=False),
    sa.Column("points_per_second", sa.Float),
    sa.Column("open", sa.Boolean, nullable=False),
    sa.Column("losses", sa.Integer, nullable=False),
)

# Keys that callers send to make a job once. Held by a lease while a request uploads, then bound to its job.
idempotency = sa.Table(
    "pcdnf_idempotency",
    metadata,
    sa.Column("owner", sa.String(64), primary_key=True),
    sa.Column("key", sa.String(255), primary_key=True),
    sa.Column("token", sa.String(32), nullable=False),
    sa.Column("lease_until", sa.BigInteger),
    sa.Column("job", sa.String(64), sa.ForeignKey("pcdnf_jobs.id", ondelete="CASCADE"), index=True),
    sa.Column("fingerprint", sa.String(64)),
)


class now_ms(sa.sql.functions.GenericFunction[int]):
    """Milliseconds since 1970 by the clock of the database, which all processes share."""

    type = sa.BigInteger()
    name = "now_ms"
    inherit_cache = True


@compiles(now_ms, "sqlite")
def _now_ms_sqlite(_element: now_ms, _compiler: Any, **_options: Any) -> str:
    return "CAST(ROUND((julianday('now') - 2440587.5) * 86400000) AS INTEGER)"


@compiles(now_ms, "postgresql")
def _now_ms_postgresql(_element: now_ms, _compiler: Any, **_options: Any) -> str:
    return "CAST(EXTRACT(EPOCH FROM clock_timestamp()) * 1000 AS BIGINT)"


def create_engine(settings: Settings) -> sa.Engine:
    """Return the engine of the job database; nothing is created yet."""
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
        pool_size=10,
        max_overflow=0,
        connect_args={"timeout": SQLITE_BUSY_MS / 1000},
        hide_parameters=True,  # errors are logged, and callers' file names are none of the log's affair
    )

    @sa.event.listens_for(engine, "handle_error")
    def full(context: sa.engine.ExceptionContext) -> None:
        if getattr(context.original_exception, "sqlite_errorcode", None) == sqlite3.SQLITE_FULL:
            context.is_disconnect = True  # as a database that is away, for which the engine waits

    @sa.event.listens_for(engine, "connect")
    def prepare(connection: sqlite3.Connection, _record: object) -> None:
        connection.isolation_level = "IMMEDIATE"
        connection.execute(f"PRAGMA busy_timeout={SQLITE_BUSY_MS}")
        connection.execute("PRAGMA foreign_keys=ON")
        connection.execute("PRAGMA synchronous=FULL")  # an accepted job survives a power loss

    return engine


def migrate(settings: Settings) -> None:
    """Create or upgrade the tables; safe to call from several processes at once.

    Raises
    ------
    sqlalchemy.exc.SQLAlchemyError
        If the database cannot be reached.
    """
    settings.data_dir.mkdir(parents=True, exist_ok=True)
    url = settings.resolved_database_url
    with _one_process(settings.data_dir / "migrate.lock"):
        if url.startswith("sqlite"):
            database = sa.make_url(url).database
            assert database is not None
            with sqlite3.connect(database) as connection:
                connection.execute("PRAGMA journal_mode=WAL")
            connection.close()
        DBOS.migrate(url)
        engine = create_engine(settings)
        try:
            with engine.begin() as connection_:
                if engine.dialect.name == "postgresql":
                    connection_.execute(sa.text(f"SELECT pg_advisory_xact_lock({MIGRATION_LOCK})"))
                metadata.create_all(connection_)
                _add_columns(connection_)
        finally:
            engine.dispose()


def lacking(engine: sa.Engine) -> str | None:
    """Return the first table or column of ours that a database does not have."""
    schema = sa.inspect(engine)
    tables = set(schema.get_table_names())
    for table in metadata.sorted_tables:
        if table.name not in tables:
            return table.name
        known = {column["name"] for column in schema.get_columns(table.name)}
        for column in table.columns:
            if column.name not in known:
                return f"{table.name}.{column.name}"
    return None


def _add_columns(connection: sa.Connection) -> None:
    """Give the tables of an older version the columns they lack; a column added later may be NULL."""
    schema = sa.inspect(connection)
    for table in metadata.sorted_tables:
        known = {column["name"] for column in schema.get_columns(table.name)}
        for column in table.columns:
            if column.name not in known:
                kind = column.type.compile(connection.dialect)
                connection.execute(sa.text(f"ALTER TABLE {table.name} ADD COLUMN {column.name} {kind}"))


@contextmanager
def exclusive(connection: sa.Connection) -> Iterator[None]:
    """Run a transaction that no other one of this kind overlaps: what it reads stays true until it has written."""
    with connection.begin():
        # The driver of SQLite begins a transaction at the first write only, and what was read before may be old.
        begin = {"sqlite": "BEGIN IMMEDIATE", "postgresql": f"SELECT pg_advisory_xact_lock({ADMISSION_LOCK})"}
        connection.exec_driver_sql(begin[connection.dialect.name])
        yield


@contextmanager
def _one_process(path: Path) -> Iterator[None]:
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
