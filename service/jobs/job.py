"""A job: one row of the table of jobs."""

from __future__ import annotations

import re
import secrets
from dataclasses import dataclass, fields
from typing import Any

import sqlalchemy as sa

from ..database.tables import jobs as table

LIVE = ("queued", "running", "cancelling")
FINISHED = ("succeeded", "failed", "cancelled")


@dataclass(frozen=True)
class Job:
    """Times are in milliseconds since 1970, progress in points times iterations."""

    id: str
    owner: str
    status: str
    parameters: dict[str, Any]
    upload: dict[str, Any]
    execution: dict[str, Any] | None
    results: dict[str, Any] | None
    warnings: list[str]
    problem: dict[str, Any] | None
    done: int
    total: int
    points_per_second: float | None
    created_at: int
    started_at: int | None
    finished_at: int | None
    expires_at: int | None
    purged_at: int | None
    leased: bool
    crashes: int
    context: dict[str, str] | None
    batch: str | None = None
    place: int | None = None  # of its file in the batch
    callback: str | None = None
    shard: str | None = None  # the shard that a worker computes, if not the whole job

    @property
    def work(self) -> str:
        """The id of what a worker computes: the shard, or the job."""
        return self.shard or self.id

    @property
    def live(self) -> bool:
        """Whether it may still change."""
        return self.status in LIVE


def ignored_classes(text: str) -> list[int]:
    """Return the numbers of the parameter `ignore_classes`, such as ``7,18``; none for an empty text."""
    return [int(part) for part in text.split(",") if part]


def new_id() -> str:
    """Return the id of a new job: 128 random bits in hex."""
    return secrets.token_hex(16)


def is_id(text: str) -> bool:
    """Return whether a caller's text may be the id of a job; not every text may be sent to a database."""
    return re.fullmatch("[0-9a-f]{32}", text) is not None


def as_job(row: sa.RowMapping) -> Job:
    """Return the row as a :class:`Job`."""
    return Job(**{field.name: row[table.c[field.name]] for field in fields(Job) if field.name != "shard"})
