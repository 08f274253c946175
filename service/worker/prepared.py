"""The cloud of a pass, prepared for its tiles."""

from __future__ import annotations

import logging
import zlib
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from pcdnf.denoiser import Denoiser, Plan, iteration_seed
from pcdnf.errors import PcdnfError
from pcdnf.formats.scanner_positions import known_sides
from pcdnf.inference.options import check_sensor
from pcdnf.inference.unit_frame import UnitFrame

from ..jobs.job import Job
from .artifacts import load_arrays, read_upload
from .cloud_cache import PreparedCloud
from .context import Runtime
from .progress import Progress

log = logging.getLogger(__name__)

DIFFERS = "workers_differ"


@dataclass(frozen=True)
class Pass:
    """One iteration: its number, the merged cloud of the one before, and the order of its points once that is known."""

    iteration: int
    before: str | None
    order: int | None = None


def prepared(runtime: Runtime, job: Job, now: Pass) -> PreparedCloud:
    """Return the cloud of an iteration, prepared now unless it was kept.

    Raises
    ------
    PcdnfError
        If the file, the cloud or the model is not usable, or the weights are not those the job began with.
    pcdnf.denoiser.StoppedError
        If the job was cancelled meanwhile.
    """
    progress = Progress(runtime, job, 0)
    with runtime.clouds.preparing(job.id, progress.check):
        cached = runtime.clouds.get(job.id)
        if cached is None or cached.iteration != now.iteration:
            cached = _prepare(runtime, job, now, progress)
    if now.order is not None and cached.order != now.order:
        raise PcdnfError(
            "This worker orders the points of the cloud differently from the worker that began the job.",
            code=DIFFERS,
            hint="Submit the file again. Run all workers of a queue on the same kind of machine.",
        )
    return cached


def _prepare(runtime: Runtime, job: Job, now: Pass, progress: Progress) -> PreparedCloud:
    iteration = now.iteration
    with runtime.at_work(job, progress.check), runtime.stage("prepare"):
        runtime.clouds.remove(job.id)  # the cloud before may be large
        runtime.clouds.remove_idle(0)
        denoiser = pinned_model(runtime, job)
        given = read_upload(runtime, job)
        points: NDArray[Any] = given.points
        normals = known_sides(given, check_sensor(job.parameters.get("sensor", "")))
        if now.before is not None:
            merged = load_arrays(runtime, job.id, now.before)
            points, normals = merged["points"], merged["normals"]
        cloud = denoiser.prepare(
            points,
            normals,
            plan=planned(job),
            iteration=iteration,
            frame=UnitFrame.of(given.points),
            initial="input" if iteration else job.parameters["normals"],
            seed=iteration_seed(job.parameters["seed"], iteration),
            should_stop=progress.stop,
            came=given.points,
            oriented=given.normals is not None,
        )
        fresh = PreparedCloud(iteration, denoiser, cloud, zlib.crc32(cloud.order.tobytes()))
        runtime.clouds.put(job.id, fresh)
        return fresh


def pinned_model(runtime: Runtime, job: Job) -> Denoiser:
    """Return the job's model, having recorded on what the job runs; the weights may not change under it.

    Raises
    ------
    PcdnfError
        If the weights are not those the job began with.
    """
    execution = runtime.models.execution(job.parameters["model"])
    known = job.execution or {}
    if known and known["weights_sha256"] != execution["weights_sha256"]:
        raise PcdnfError(
            "The weights of the model were replaced while this job was running.",
            code="model_changed",
            hint="Submit the file again.",
        )
    if job.shard is None and known != known | execution:
        runtime.attempts.update(job.id, execution=known | execution)
    return runtime.models.get(job.parameters["model"])


def planned(job: Job) -> Plan:
    """Return the plan that the first step of the job left with it."""
    assert job.execution is not None
    return Plan.from_json(job.execution["plan"])
