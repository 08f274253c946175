"""Tables of the job database.

Names of tables and columns are persisted: they are added to, never renamed. A ``key`` gives a column the name that the
code uses today.
"""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa
from sqlalchemy.ext.compiler import compiles

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
    # Whether a worker holds a lease on it, and how many crashed with one since its last tile.
    sa.Column("open", sa.Boolean, nullable=False, key="leased"),
    sa.Column("losses", sa.Integer, nullable=False, key="crashes"),
    # `request_id` and `traceparent` of the request that made the job.
    sa.Column("context", sa.JSON),
    # The request with several files that made the job, and which file of it.
    sa.Column("batch", sa.String(64), index=True),
    sa.Column("place", sa.Integer),
    # What has become of its callback, if it has one; see service.jobs.callback.State.
    sa.Column("callback", sa.String(16), index=True),
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
    # What it measured, as text for Prometheus; see service.api.metrics.
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


# Shards of the tiles of one large job, while several workers compute them.
shards = sa.Table(
    "pcdnf_shares",
    metadata,
    sa.Column("id", sa.String(128), primary_key=True),
    sa.Column("job", sa.String(64), sa.ForeignKey("pcdnf_jobs.id", ondelete="CASCADE"), nullable=False, index=True),
    # Points over all iterations, as in the columns of the job: where this shard starts, and what is done of it.
    sa.Column("start", sa.BigInteger, nullable=False),
    sa.Column("done", sa.BigInteger, nullable=False),
    sa.Column("points_per_second", sa.Float),
    sa.Column("open", sa.Boolean, nullable=False, key="leased"),
    sa.Column("losses", sa.Integer, nullable=False, key="crashes"),
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
