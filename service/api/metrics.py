"""The metrics of ``/metrics``, in the format of Prometheus.

They have three sources: the requests of this process, the jobs and workers in the database, and the metrics of each
worker, which it stores in its row of the table of workers with every heartbeat. The page is therefore complete for any
number of processes, and workers need no open port. What comes from the database is the same in every API process. No
label contains data of a caller: no job id, no file name, no key.
"""

from __future__ import annotations

import math
import platform
import time
from collections.abc import Iterator

import prometheus_client
import sqlalchemy as sa
from prometheus_client import CollectorRegistry, Gauge, Histogram, Info
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.parser import text_string_to_metric_families
from prometheus_client.registry import Collector
from sqlalchemy.exc import SQLAlchemyError

import pcdnf

from ..database.tables import jobs as table
from ..database.tables import now_ms
from ..jobs import drain_switch, outcomes
from ..jobs.job import LIVE
from ..jobs.worker_registry import Worker, Workers
from ..settings import Settings
from ..storage.base import Storage, StorageError

DISK_SECONDS = 60.0  # between two looks at what the files take
REQUEST_BUCKETS = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1, 2.5, 5, 10, 30, 60, 300)
WORKER_INFO = ("device", "precision", "model", "version")

prometheus_client.disable_created_metrics()  # type: ignore[no-untyped-call]


class ApiMetrics:
    """What one API process measures.

    Attributes
    ----------
    registry : CollectorRegistry
    request_duration : Histogram
        By method, route template and status.
    requests_in_progress : Gauge
    submission_stage : Histogram
        The stages of taking a cloud in.
    """

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        self.request_duration = Histogram(
            "pcdnf_http_request_duration_seconds",
            "Time from a request's head to the end of its answer",
            ["method", "route", "status"],
            buckets=REQUEST_BUCKETS,
            registry=self.registry,
        )
        self.requests_in_progress = Gauge(
            "pcdnf_http_requests_in_progress", "Requests being answered", registry=self.registry
        )
        self.submission_stage = Histogram(
            "pcdnf_submission_stage_duration_seconds",
            "Time of the stages in which an upload becomes a job",
            ["stage"],
            buckets=REQUEST_BUCKETS,
            registry=self.registry,
        )
        build = Info("pcdnf_build", "The version at work", registry=self.registry)
        build.info({"version": pcdnf.__version__, "python": platform.python_version()})


class Deployment(Collector):
    """Metrics of all processes together, from the database and the storage.

    Parameters
    ----------
    engine : sqlalchemy.Engine
    storage : Storage
    settings : Settings
    """

    def __init__(self, engine: sa.Engine, storage: Storage, settings: Settings) -> None:
        self._engine, self._storage, self._settings = engine, storage, settings
        self._workers = Workers(engine)
        self._used = 0.0
        self._looked = -DISK_SECONDS

    def collect(self) -> Iterator[Metric]:
        """Return all metrics, or only those of the disk if the database does not answer."""
        yield from self._disk()
        try:
            families = [*self._queue(), *self._beating()]
        except SQLAlchemyError:
            families = []
        yield _gauge("pcdnf_database_up", "Whether the job database answers", 1.0 if families else 0.0)
        yield from families

    def _disk(self) -> Iterator[Metric]:
        if time.monotonic() - self._looked >= DISK_SECONDS:
            self._looked = time.monotonic()
            try:
                self._used = float(self._storage.used_bytes())
            except StorageError:
                self._used = math.nan
        free, settings = self._storage.free_bytes(), self._settings
        yield _gauge("pcdnf_storage_up", "Whether the storage answers", not math.isnan(self._used))
        yield _gauge("pcdnf_disk_free_bytes", "Free space of the disk", free)
        yield _gauge("pcdnf_disk_min_free_bytes", "Free space that is kept", settings.min_free_bytes)
        yield _gauge("pcdnf_disk_used_bytes", "Files of jobs, looked at once a minute", self._used)
        yield _gauge("pcdnf_disk_budget_bytes", "Most that files may take; 0: no bound", settings.disk_budget_bytes)

    def _queue(self) -> Iterator[Metric]:
        size = sa.func.coalesce(sa.func.sum(sa.cast(table.c.upload["bytes"].as_string(), sa.BigInteger)), 0)
        left = sa.func.coalesce(sa.func.sum(table.c.total - table.c.done), 0)
        query = sa.select(table.c.status, sa.func.count(), left, size).where(table.c.status.in_(LIVE))
        oldest = sa.select(now_ms() - sa.func.min(table.c.created_at)).where(table.c.status == "queued")
        with self._engine.connect() as connection:
            rows = {row[0]: row[1:] for row in connection.execute(query.group_by(table.c.status))}
            waited = connection.execute(oldest).scalar() or 0
            ended = outcomes.counted(connection)
            drained = drain_switch.is_on(connection, drain_switch.DRAIN)
        live = GaugeMetricFamily("pcdnf_unfinished_jobs", "Jobs queued or at work", labels=["status"])
        points = GaugeMetricFamily("pcdnf_unfinished_points", "Points times passes they still need", labels=["status"])
        uploads = GaugeMetricFamily("pcdnf_unfinished_upload_bytes", "Bytes of their uploads", labels=["status"])
        for status in LIVE:
            for family, value in zip((live, points, uploads), rows.get(status, (0, 0, 0)), strict=True):
                family.add_metric([status], float(value))
        yield from (live, points, uploads)
        settings = self._settings
        yield _gauge("pcdnf_queue_limit_points", "Most points times passes the queue takes", settings.max_queued_points)
        yield _gauge("pcdnf_oldest_queued_job_age_seconds", "How long the first in the queue has waited", waited / 1000)
        finished = CounterMetricFamily(
            "pcdnf_jobs_finished", "Jobs by how they ended; code: of the problem", labels=["outcome", "code"]
        )
        for (outcome, code), count in ({("succeeded", ""): 0, ("cancelled", ""): 0} | ended).items():
            finished.add_metric([outcome, code], count)
        yield finished
        yield _gauge("pcdnf_draining", "Whether the service is drained: it takes no jobs", drained)

    def _beating(self) -> Iterator[Metric]:
        alive = self._workers.alive(self._settings.ready_stale_seconds)
        states = GaugeMetricFamily("pcdnf_workers", "Workers that gave a sign of life just now", labels=["state"])
        for state in ("starting", "ready", "stopping"):
            states.add_metric([state], sum(worker.state == state for worker in alive))
        fallback = GaugeMetricFamily(
            "pcdnf_worker_cpu_fallback", "Whether the CPU was taken because there is no GPU", labels=["worker"]
        )
        info = GaugeMetricFamily("pcdnf_worker_info", "On what a worker runs", labels=["worker", *WORKER_INFO])
        for worker in alive:
            if worker.details:
                fallback.add_metric([worker.id], float(worker.details["cpu_fallback"]))
                info.add_metric([worker.id, *(worker.details[name] for name in WORKER_INFO)], 1.0)
        yield from (states, fallback, info)
        yield from _measured(alive)


def _measured(workers: list[Worker]) -> Iterator[Metric]:
    """Return what these workers measured, a label telling them apart."""
    families: dict[str, Metric] = {}
    for worker in workers:
        for found in text_string_to_metric_families(worker.metrics or ""):
            family = families.setdefault(found.name, Metric(found.name, found.documentation, found.type))
            for sample in found.samples:
                family.add_sample(sample.name, {"worker": worker.id} | sample.labels, sample.value)
    yield from families.values()


def _gauge(name: str, text: str, value: float) -> Metric:
    return GaugeMetricFamily(name, text, value=float(value))
