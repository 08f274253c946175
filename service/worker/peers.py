"""The comparison of workers: only workers that compute alike may share a job."""

from __future__ import annotations

from typing import Any

from ..jobs.job import Job
from ..jobs.worker_registry import Workers
from ..settings import Settings
from .model_cache import ModelCache


class Peers:
    """The other workers of the service, seen from one.

    Parameters
    ----------
    models : ModelCache
    workers : Workers
    settings : Settings
    """

    def __init__(self, models: ModelCache, workers: Workers, settings: Settings) -> None:
        self._models, self._workers, self._settings = models, workers, settings

    def computes_alike(self, job: Job) -> bool:
        """Return whether this worker computes like the one that began `job`."""
        return _kind(self._models.execution(job.parameters["model"])) == _kind(job.execution or {})

    def exist(self) -> bool:
        """Return whether there are other workers that are ready, and all of them compute like this one."""
        mine = _kind(self._models.execution(self._settings.default_model))
        alive = self._workers.alive(self._settings.ready_stale_seconds)
        ready = [worker for worker in alive if worker.state == "ready"]
        return len(ready) > 1 and all(_kind(worker.details) == mine for worker in ready)


def _kind(execution: dict[str, Any]) -> tuple[Any, ...]:
    """Return what the bits of a result depend on, as far as a worker reports it."""
    return (str(execution.get("device")).partition(":")[0], execution.get("precision"), execution.get("version"))
