"""Readiness: a worker with a warm model and a fresh heartbeat, a database that answers, enough disk space."""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa
from pydantic import BaseModel, Field
from sqlalchemy.exc import SQLAlchemyError

from ..database.damage import SENTENCES, Checkup, damage_of
from ..jobs import drain_switch
from ..jobs.worker_registry import Workers
from ..problems import Problem
from ..settings import Settings
from ..storage.base import Storage, StorageError

NOT_YET = {"starting": "A worker is loading its model.", "stopping": "The worker is stopping."}


class WorkerView(BaseModel):
    """A worker."""

    id: str
    state: str = Field(description="`starting`, `ready` or `stopping`")
    device: str | None = None
    device_requested: str | None = None
    cpu_fallback: bool | None = Field(None, description="Whether `auto` chose the CPU because there is no GPU")
    precision: str | None = None
    model: str | None = None
    weights_sha256: str | None = None
    version: str | None = None
    points_per_second: float | None = None
    beat_seconds_ago: float


class Readiness(BaseModel):
    """The service is ready."""

    status: str = "ready"
    workers: list[WorkerView]
    free_bytes: int


def readiness(
    workers: Workers,
    engine: sa.Engine,
    storage: Storage,
    settings: Settings,
    checkup: Checkup,
    *,
    stopping: bool = False,
) -> Readiness:
    """Return the state of the service.

    Raises
    ------
    Problem
        503 ``not_ready``, naming every check that failed.
    """
    failed = ["The service is stopping."] if stopping else []
    damage = checkup.damage()
    views: list[WorkerView] = []
    try:
        with engine.connect() as connection:
            drained = drain_switch.is_on(connection, drain_switch.DRAIN)
        if drained:
            failed.append("The service is draining and takes no new jobs.")
        views = [
            WorkerView(
                id=worker.id,
                state=worker.state,
                points_per_second=worker.points_per_second,
                beat_seconds_ago=round(max(0.0, worker.age_seconds), 1),
                **worker.details,
            )
            for worker in workers.alive(settings.ready_stale_seconds)
        ]
        if not any(view.state == "ready" for view in views):
            states = {view.state for view in views}
            failed.append(next((text for state, text in NOT_YET.items() if state in states), "No worker is running."))
    except SQLAlchemyError as error:
        damage = damage or damage_of(error)
        if damage is None:
            failed.append("The job database does not answer.")
    if damage is not None:
        failed.append(SENTENCES[damage])
    try:
        storage.check()
    except StorageError:
        failed.append("The storage does not answer.")
    free = storage.free_bytes()
    if free < settings.min_free_bytes:
        failed.append(f"Only {free} bytes of disk space are free, fewer than PCDNF_MIN_FREE_BYTES.")
    if failed:
        shown: list[dict[str, Any]] = [view.model_dump(exclude_none=True) for view in views]
        raise Problem(
            "not_ready",
            " ".join(failed),
            hint="Run `pcdnf doctor` on the machine of the service: it says what to do."
            if damage
            else "Wait until the service has started. If this goes on, run `pcdnf doctor` on its machine.",
            headers={"Retry-After": "2"},
            workers=shown,
            free_bytes=free,
            damage=damage,
        )
    return Readiness(workers=views, free_bytes=free)
