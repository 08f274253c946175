"""The number of finished jobs by outcome, counted in the transaction that ends a job, so it survives every crash."""

from __future__ import annotations

import sqlalchemy as sa

from ..database.tables import outcomes as table

_COUNT = sa.text(
    "INSERT INTO pcdnf_outcomes (outcome, code, jobs) VALUES (:outcome, :code, 1) "
    "ON CONFLICT (outcome, code) DO UPDATE SET jobs = pcdnf_outcomes.jobs + 1"
)


def count(connection: sa.Connection, outcome: str, code: str = "") -> None:
    """Count a job that ends in this transaction: `outcome` is its last status, `code` that of its problem."""
    connection.execute(_COUNT, {"outcome": outcome, "code": code})


def counted(connection: sa.Connection) -> dict[tuple[str, str], int]:
    """Return the jobs counted so far, by outcome and code."""
    rows = connection.execute(sa.select(table.c.outcome, table.c.code, table.c.jobs))
    return {(row.outcome, row.code): row.jobs for row in rows}
