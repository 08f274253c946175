"""Answers of the service as types; unknown members of a newer service are kept."""

from __future__ import annotations

from datetime import datetime
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict

Status = Literal["queued", "running", "cancelling", "succeeded", "failed", "cancelled"]


class _Shown(BaseModel):
    model_config = ConfigDict(extra="allow", frozen=True, protected_namespaces=())


class ProblemDetail(_Shown):
    """An error in the shape of RFC 9457."""

    type: str = "about:blank"
    title: str = ""
    status: int = 0
    detail: str
    instance: str | None = None
    code: str
    hint: str | None = None
    limit: int | float | None = None
    actual: int | float | None = None


class Progress(_Shown):
    """Progress of a job, in points of the cloud times passes."""

    done: int
    total: int
    unit: str = "points"


class Plan(_Shown):
    """The plan of a job: what was estimated and chosen before it ran."""

    noise: float
    spacing: float
    radii: list[float]
    neighbours: int | None = None


class Execution(_Shown):
    """Model, device and precision that a job runs with."""

    model: str
    weights_sha256: str
    device: str
    device_requested: str
    cpu_fallback: bool
    precision: str
    version: str
    plan: Plan | None = None


class Job(_Shown):
    """A job of the service; see ``docs/api.md``.

    Times have a time zone. ``queue_position`` is 1 for the next job to run and None once it runs. ``seconds_left`` and
    ``points_per_second`` are None while they are unknown.
    """

    id: str
    status: Status
    progress: Progress
    queue_position: int | None = None
    seconds_left: float | None = None
    points_per_second: float | None = None
    created_at: datetime
    started_at: datetime | None = None
    finished_at: datetime | None = None
    expires_at: datetime | None = None
    parameters: dict[str, Any]
    execution: Execution | None = None
    upload: dict[str, Any]
    warnings: list[str] = []
    problem: ProblemDetail | None = None
    callback: str | None = None
    links: dict[str, str] = {}

    @property
    def live(self) -> bool:
        """Whether it is still queued, running or being cancelled."""
        return self.status in ("queued", "running", "cancelling")


class Model(_Shown):
    """A model that jobs may name."""

    name: str
    kind: str
    licence: str
    version: str
    sha256: str
    default: bool = False
