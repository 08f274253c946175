"""Creation and upgrade of the job database."""

from __future__ import annotations

import fcntl
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import sqlalchemy as sa
from dbos import DBOS

from ..settings import Settings
from .engine import create_engine
from .tables import metadata

MIGRATION_LOCK = 7262733  # of PostgreSQL, any number but that of another lock


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
def _one_process(path: Path) -> Iterator[None]:
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
