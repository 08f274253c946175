"""Metrics of one worker. :mod:`service.api.metrics` combines those of all workers."""

from __future__ import annotations

import os
import resource
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import torch
from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, disable_created_metrics, generate_latest

STAGES = ("survey", "prepare", "tile", "merge", "result")
STAGE_BUCKETS = (0.01, 0.03, 0.1, 0.3, 1, 3, 10, 30, 100, 300, 1000)
WAIT_BUCKETS = (0.1, 0.3, 1, 3, 10, 30, 100, 300, 1000, 3000, 10_000, 30_000)
TILE_BUCKETS = (256, 1024, 4096, 16_384, 65_536, 262_144)

disable_created_metrics()  # type: ignore[no-untyped-call]


class WorkerMetrics:
    """Counts since this worker process began."""

    def __init__(self) -> None:
        self._registry = registry = CollectorRegistry()
        self._stages = Histogram(
            "pcdnf_stage_duration_seconds",
            "Time of the stages of jobs, without waiting for the scheduler",
            ["stage"],
            buckets=STAGE_BUCKETS,
            registry=registry,
        )
        for stage in STAGES:
            self._stages.labels(stage)
        self._waits = Histogram(
            "pcdnf_queue_wait_seconds", "Time from submission to a worker", buckets=WAIT_BUCKETS, registry=registry
        )
        self._tiles = Histogram("pcdnf_tile_points", "Points of a tile", buckets=TILE_BUCKETS, registry=registry)
        self._points = Counter(
            "pcdnf_points_processed", "Points times passes denoised", ["model", "device"], registry=registry
        )
        self._batch = Gauge(
            "pcdnf_batch_patches",
            "Patches in a batch; halved when a device runs out of memory",
            ["model", "device"],
            registry=registry,
        )
        self._used = Gauge(
            "pcdnf_device_memory_used_bytes",
            "Memory held on the device; on the CPU, of the worker's process",
            ["device"],
            registry=registry,
        )
        self._total = Gauge("pcdnf_device_memory_total_bytes", "Memory of the device", ["device"], registry=registry)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time a stage that ends well."""
        began = time.monotonic()
        yield
        self._stages.labels(name).observe(time.monotonic() - began)

    def waited(self, seconds: float) -> None:
        """Take note of how long a job waited in the queue."""
        self._waits.observe(seconds)

    def tile(self, model: str, device: str, points: int, batch: int, seconds: float) -> None:
        """Take note of a finished tile, and of the time it was computed in."""
        self._stages.labels("tile").observe(seconds)
        self._tiles.observe(points)
        self._points.labels(model, device).inc(points)
        self._batch.labels(model, device).set(batch)

    def text(self, device: str) -> str:
        """Return everything as text for Prometheus, the memory of `device` as it is now."""
        used, total = _memory(device)
        self._used.labels(device).set(used)
        self._total.labels(device).set(total)
        return generate_latest(self._registry).decode()


def _memory(device: str) -> tuple[int, int]:
    """Return the bytes in use and in total; for the CPU both are known on Linux only."""
    if device != "cpu":
        return torch.cuda.memory_reserved(device), torch.cuda.get_device_properties(device).total_memory
    page = resource.getpagesize()
    try:
        resident = int(Path("/proc/self/statm").read_text().split()[1])
    except FileNotFoundError:
        return 0, 0
    return resident * page, os.sysconf("SC_PHYS_PAGES") * page
