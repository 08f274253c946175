"""The JSON of jobs and models."""

from __future__ import annotations

import math
from collections import Counter
from datetime import UTC, datetime
from functools import cache
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from pcdnf.models.catalog import available_models

from ..jobs.eta import Eta
from ..jobs.job import Job
from .error_handlers import ProblemDetail

LONGEST_RETRY = 30
Status = Literal["queued", "running", "cancelling", "succeeded", "failed", "cancelled"]


EXAMPLE: dict[str, Any] = {
    "id": "0f8fad5bd9cb469fa16570867728950e",
    "status": "running",
    "progress": {"done": 16384, "total": 80000, "unit": "points"},
    "queue_position": None,
    "seconds_left": 21.2,
    "points_per_second": 3000.0,
    "created_at": "2026-01-31T12:00:00Z",
    "started_at": "2026-01-31T12:00:01Z",
    "finished_at": None,
    "expires_at": None,
    "parameters": {
        "iterations": "auto",
        "radius": "auto",
        "fast": False,
        "model": "pcdnf-lite",
        "seed": 0,
        "normals": "auto",
        "orient": False,
        "outliers": "keep",
        "sensor": "",
        "nonfinite": "keep",
        "ignore_classes": "",
        "coordinates": "keep",
        "diagnostics": False,
    },
    "execution": {
        "model": "pcdnf-lite",
        "weights_sha256": "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855",
        "device": "cpu",
        "device_requested": "auto",
        "cpu_fallback": True,
        "precision": "float32",
        "version": "0.1.0",
        "plan": {"noise": 0.21, "spacing": 0.35, "radii": [3.1, 2.8]},
    },
    "upload": {"name": "scan", "format": "ply", "bytes": 480180, "points": 40000, "has_normals": False},
    "warnings": [],
    "problem": None,
    "callback": None,
    "links": {
        "self": "/jobs/0f8fad5bd9cb469fa16570867728950e",
        "events": "/jobs/0f8fad5bd9cb469fa16570867728950e/events",
        "cancel": "/jobs/0f8fad5bd9cb469fa16570867728950e/cancel",
    },
}


class ProgressView(BaseModel):
    """How far a job is."""

    done: int
    total: int = Field(description="Points of the cloud times iterations; a guess until the job runs")
    unit: Literal["points"] = "points"


class PlanView(BaseModel):
    """What was chosen for a job, or found out; lengths in the unit of the file."""

    noise: float = Field(description="Estimated standard deviation of the distance from the surface")
    spacing: float = Field(description="Estimated side of the square of surface that a point stands for")
    radii: list[float] = Field(description="Size of the neighbourhoods of each iteration")
    neighbours: int | None = Field(None, description="Of each point, in the fast form; null for the model's own number")


class ExecutionView(BaseModel):
    """On what a job runs; known once it runs."""

    model: str
    weights_sha256: str
    device: str
    device_requested: str
    cpu_fallback: bool = Field(description="Whether the CPU was taken because there is no GPU")
    precision: str
    version: str
    plan: PlanView | None = None


class JobView(BaseModel):
    """A job."""

    model_config = ConfigDict(json_schema_extra={"examples": [EXAMPLE]})

    id: str
    status: Status
    progress: ProgressView
    queue_position: int | None = Field(description="1 is next; null once the job runs")
    seconds_left: float | None = Field(description="Estimated; null while nothing is known")
    points_per_second: float | None = Field(description="Speed of this job")
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None
    expires_at: datetime | None = Field(description="When a finished job and its files are removed")
    parameters: dict[str, Any] = Field(description="The parameters in force")
    execution: ExecutionView | None
    upload: dict[str, Any] = Field(description="`name`, `format`, `bytes`, `points` and `has_normals` of the file")
    warnings: list[str]
    problem: ProblemDetail | None = Field(description="Why a failed job failed")
    callback: Literal["due", "queued", "delivered", "given_up"] | None = Field(
        None, description="What has become of the message to `callback_url`"
    )
    links: dict[str, str]


def _time(milliseconds: int | None) -> datetime | None:
    return None if milliseconds is None else datetime.fromtimestamp(milliseconds / 1000, UTC)


def job_view(job: Job, eta: Eta) -> JobView:
    """Return the JSON of a job."""
    links = {"self": f"/jobs/{job.id}"}
    if job.live:
        links["events"] = f"/jobs/{job.id}/events"
        links["cancel"] = f"/jobs/{job.id}/cancel"
    if job.batch is not None:
        links["batch"] = f"/batches/{job.batch}"
    if job.status == "succeeded":
        links["result"] = f"/jobs/{job.id}/result"
        links["display"] = f"/jobs/{job.id}/display"
    created = _time(job.created_at)
    assert created is not None
    return JobView(
        id=job.id,
        status=job.status,
        progress=ProgressView(done=job.done, total=job.total),
        queue_position=eta.queue_position,
        seconds_left=None if eta.seconds_left is None else round(eta.seconds_left, 1),
        points_per_second=None if job.points_per_second is None else round(job.points_per_second, 1),
        created_at=created,
        started_at=_time(job.started_at),
        finished_at=_time(job.finished_at),
        expires_at=_time(job.expires_at),
        parameters=job.parameters,
        execution=None if job.execution is None else ExecutionView(**job.execution),
        upload=job.upload,
        warnings=job.warnings,
        problem=None if job.problem is None else ProblemDetail(**job.problem),
        callback=job.callback,
        links=links,
    )


class BatchView(BaseModel):
    """The jobs of one request with several files."""

    id: str
    status: Literal["live", "finished"] = Field(description="`finished` once every job has ended, however it ended")
    counts: dict[str, int] = Field(description="Number of jobs by their status")
    jobs: list[JobView] = Field(description="In the order of the files")
    links: dict[str, str]


def batch_view(batch_id: str, jobs: list[tuple[Job, Eta]]) -> BatchView:
    """Return the JSON of a batch."""
    live = any(job.live for job, _ in jobs)
    links = {"self": f"/batches/{batch_id}"}
    if not live:
        links["results"] = f"/batches/{batch_id}/results"
    return BatchView(
        id=batch_id,
        status="live" if live else "finished",
        counts=dict(Counter(job.status for job, _ in jobs)),
        jobs=[job_view(job, eta) for job, eta in jobs],
        links=links,
    )


def retry_after(eta: Eta) -> str:
    """Return the seconds after which to ask again: half of what is left, between 1 and 30."""
    left = 2.0 if eta.seconds_left is None else eta.seconds_left / 2
    return str(min(LONGEST_RETRY, max(1, math.ceil(left))))


class Model(BaseModel):
    """A model that jobs may name."""

    name: str
    kind: str = Field(description="The network: `pcdnf` (the paper's) or `lite`")
    licence: str
    version: str = Field(description="The release that wrote the file")
    sha256: str = Field(description="Of the file of weights, checked on every load")
    recipe: dict[str, Any] = Field(description="How neighbourhoods are taken")
    training: dict[str, Any] = Field(description="Facts about the training")
    default: bool = Field(False, description="Whether jobs that name no model use this one")


@cache
def shipped() -> dict[str, Model]:
    """Return the shipped models by name."""
    names = ("kind", "sha256", "licence", "version", "recipe", "training")
    return {
        info.name: Model(name=info.name, **{name: getattr(info, name) for name in names}) for info in available_models()
    }
