"""The steps of a job: survey, then plan, tiles and merge for each pass, then the files of the result.

Each step is checkpointed by DBOS. It stores its arrays as a file and returns plain JSON. An error that the caller
should see is returned as ``{"problem": ...}``, not raised.
"""

from __future__ import annotations

import functools
import logging
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from dbos import DBOS
from numpy.typing import NDArray

from pcdnf.denoiser import StoppedError
from pcdnf.errors import PcdnfError
from pcdnf.file_formats import FORMATS
from pcdnf.formats import write
from pcdnf.formats.attributes import with_columns
from pcdnf.formats.coordinates import without_steps
from pcdnf.formats.scanner_positions import known_sides
from pcdnf.geometry.orientation import orient_normals
from pcdnf.inference.diagnostics import diagnose
from pcdnf.inference.options import check_sensor

from ..jobs.dbos_contract import GIVEN_UP
from ..jobs.files import DISPLAY, UPLOAD, job_file, result_facts, result_name
from ..jobs.job import Job
from ..jobs.shards import Part, cut
from ..problems import CATALOGUE, Problem
from ..storage.base import own_name, writing
from ..telemetry import tracing
from .artifacts import (
    INITIAL_NORMALS,
    DiskFullError,
    load_arrays,
    merged_name,
    read_upload,
    retry_while_disk_full,
    store_arrays,
    tile_name,
)
from .context import Runtime, runtime
from .gltf import colours, write_display
from .prepared import Pass, pinned_model, planned, prepared
from .progress import Progress
from .speeds import speed_key

log = logging.getLogger(__name__)

STORED = ("ply", "npz")  # in addition to the format of the upload; others are written on demand
Outcome = dict[str, Any]


def problem_of(code: str, detail: str | None = None, hint: str | None = None) -> dict[str, Any]:
    """Return the problem that a failed job shows; only the codes listed here may come without a detail."""
    known = {
        "disk_full": ("The service ran out of disk space.", "Submit the file again later."),
        "internal_error": (
            "The service failed because of an internal error.",
            "Look up the id of the job in the log of the worker.",
        ),
    }
    detail, hint = (detail, hint or "Submit the file again.") if detail else known[code]
    status = None if code in CATALOGUE else 422
    return Problem(code, detail, hint=hint, status=status).body()


def result_files(results: dict[str, Any]) -> frozenset[str]:
    """Return the files that stay of a job that has succeeded."""
    return frozenset({UPLOAD, DISPLAY, *(result_name(name, facts) for name, facts in results.items())})


def sweep(job_id: str) -> None:
    """Remove the files of a job that has ended, except its results."""
    job = runtime().attempts.get(job_id)
    if job is None or not job.live:
        results = None if job is None else job.results
        runtime().storage.delete_job(job_id, keep=result_files(results) if results else frozenset())


def _step(name: str) -> Callable[[Callable[..., Outcome]], Callable[..., Outcome]]:
    """Make `function(runtime, job, ...)` a checkpointed step that is called with the job's id.

    Parameters
    ----------
    name : str
        The step's name in the job database. It is persisted and does not change with that of the function.
    """
    return functools.partial(_as_step, name)


def _as_step(name: str, function: Callable[..., Outcome]) -> Callable[..., Outcome]:
    @functools.wraps(function)
    def step(job_id: str, *arguments: Any) -> Outcome:
        job = runtime().attempts.get(job_id)
        if job is None or job.status != "running":
            return {"stopped": True}
        try:
            # The workflow that this step belongs to is the job's, or that of a shard.
            return retry_while_disk_full(runtime(), str(DBOS.workflow_id), lambda: function(runtime(), job, *arguments))
        except StoppedError:
            return {"stopped": True}
        except PcdnfError as error:
            return {"problem": problem_of(error.code, str(error), error.hint)}
        except DiskFullError:
            return {"problem": problem_of("disk_full")}
        except MemoryError:
            detail = "The worker does not have enough memory for this cloud."
            return {"problem": problem_of("out_of_memory", detail, "Split the cloud into smaller parts.")}
        finally:
            sweep(job_id)  # a worker that was frozen may have stored files after another one had ended the job

    return DBOS.step(name=name, retries_allowed=True, max_attempts=3)(step)


@_step("survey")
def survey(runtime: Runtime, job: Job) -> Outcome:
    """Measure noise and spacing, and choose the parameters that the caller left open."""
    with runtime.at_work(job, Progress(runtime, job, 0).check), runtime.stage("survey"):
        denoiser = pinned_model(runtime, job)
        points = read_upload(runtime, job).points
        asked = job.parameters
        chosen = denoiser.plan(
            points, iterations=asked["iterations"], radius=asked["radius"], fast=asked.get("fast", False)
        )
        if asked["iterations"] == "auto":
            chosen = replace(chosen, radii=chosen.radii[: runtime.settings.max_iterations])
    execution = runtime.models.execution(job.parameters["model"]) | {"plan": chosen.to_json()}
    runtime.attempts.update(job.id, execution=execution, total=chosen.iterations * len(points))
    return {"iterations": chosen.iterations}


@_step("plan")
def plan(runtime: Runtime, job: Job, iteration: int, before: str | None) -> Outcome:
    """Prepare the cloud of an iteration and divide it into tiles, and into shards if other workers can help."""
    work = prepared(runtime, job, Pass(iteration, before))
    tiles = [list(tile) for tile in work.cloud.tiles(runtime.settings.tile_points)]
    outcome = {"tiles": tiles, "order": work.order}
    parts = cut(tiles)
    if parts and runtime.peers.exist() and runtime.shards.begin(job.id, iteration, len(work.cloud), parts):
        return outcome | {"shares": parts}
    runtime.shards.finish(job.id)
    return outcome


@_step("denoise_one")
def denoise_tile(runtime: Runtime, job: Job, now: Pass, start: int, stop: int, shard: str | None = None) -> Outcome:
    """Denoise one tile, of a job or of a shard of one, and store it."""
    if shard is not None:
        job = runtime.shards.part_of(job, shard)
    work = prepared(runtime, job, now)
    base = now.iteration * len(work.cloud)
    done, model, name = base + start, job.parameters["model"], tile_name(now.iteration, start)
    left = job.total - job.done
    with runtime.at_work(job, Progress(runtime, job, done).check, left=left) as yield_to_smaller, tracing.span("tile"):
        progress = Progress(runtime, job, done, yield_to_smaller)
        began = time.monotonic()
        tile = work.denoiser.denoise_tile(work.cloud, start, stop, progress=progress.report, should_stop=progress.stop)
        seconds = time.monotonic() - began - progress.yielded_seconds
        runtime.speeds.add(speed_key(job), stop - start, seconds)
        runtime.metrics.tile(model, work.denoiser.device, stop - start, work.denoiser.batch, seconds)
        store_arrays(runtime, job.id, name, points=tile.points, normals=tile.normals, flagged=tile.flagged)
        runtime.record(job).finished_tile(
            job.work, done=base + stop, points_per_second=runtime.speeds.of(speed_key(job))
        )
    log.info("job %s iteration %d tile %d-%d done", job.id, now.iteration, start, stop)
    return {"file": name}


@_step("gather")
def gather(runtime: Runtime, job: Job, ids: list[str]) -> Outcome:
    """Wait until all shards of an iteration have finished on their workers; return the outcome of each."""
    runtime.attempts.release(job.id)  # from here on a crash counts for a shard
    while True:
        found = {each.workflow_id: each for each in DBOS.list_workflows(workflow_ids=ids, load_input=False)}
        outcomes = [found[shard].output if found[shard].status == "SUCCESS" else None for shard in ids]
        ended = next((each for each in outcomes if each and not each.keys() & {"files", "declined"}), None)
        if any(each.status in GIVEN_UP for each in found.values()):
            ended = {"problem": problem_of("internal_error")}
        if ended is None and None not in outcomes:
            runtime.attempts.reacquire(job.id)
            return {"outcomes": outcomes}
        runtime.in_flight.pause_if_stopping(job.work)
        now = runtime.attempts.get(job.id)
        if ended is not None or now is None or now.status != "running":
            DBOS.cancel_workflows([shard for shard in ids if found[shard].status == "ENQUEUED"])
            return ended or {"stopped": True}
        time.sleep(runtime.settings.poll_seconds)


@_step("merge")
def merge(runtime: Runtime, job: Job, now: Pass, tiles: Part, files: list[str]) -> Outcome:
    """Put the tiles of an iteration back into the order of the input."""
    cloud = prepared(runtime, job, now).cloud
    done = (now.iteration + 1) * len(cloud)
    with runtime.at_work(job, Progress(runtime, job, done).check), runtime.stage("merge"):
        points, normals = np.empty((len(cloud), 3)), np.empty((len(cloud), 3), np.float32)
        flagged = np.zeros(len(cloud), bool)
        if now.before is None:
            store_arrays(runtime, job.id, INITIAL_NORMALS, normals=cloud.normals, noise=cloud.noise(planned(job)))
        else:
            flagged |= load_arrays(runtime, job.id, now.before)["flagged"]
        for (start, stop), file in zip(tiles, files, strict=True):
            rows = cloud.order[start:stop]
            tile = load_arrays(runtime, job.id, file)
            points[rows], normals[rows] = tile["points"], tile["normals"]
            flagged[rows] |= tile["flagged"]
        name = merged_name(now.iteration)
        store_arrays(runtime, job.id, name, points=points, normals=normals, flagged=flagged)
    runtime.shards.finish(job.id)
    return {"file": name}


@_step("finish")
def finish(runtime: Runtime, job: Job, last: str) -> Outcome:
    """Write the result in the format of the upload, as PLY and as NPZ, and the preview."""
    with runtime.at_work(job, Progress(runtime, job, job.total).check), runtime.stage("result"):
        return _finished(runtime, job, load_arrays(runtime, job.id, last))


def _finished(runtime: Runtime, job: Job, merged: dict[str, NDArray[Any]]) -> Outcome:
    parameters = job.parameters
    plan = planned(job)
    given = without_steps(read_upload(runtime, job), plan.scale.noise)
    denoiser = runtime.models.get(parameters["model"])
    metadata = denoiser.metadata(seed=parameters["seed"], plan=plan, initial=parameters["normals"])
    metadata |= {"orient": "on" if parameters["orient"] else "off", "outliers": parameters["outliers"]}
    first = load_arrays(runtime, job.id, INITIAL_NORMALS)
    noise = np.broadcast_to(first.get("noise", plan.scale.noise), len(given))  # none from an older worker
    found = diagnose(given.points, merged["points"], noise)
    metadata |= found.metadata()
    normals = merged["normals"]
    if parameters["orient"]:
        sensor = check_sensor(parameters.get("sensor", ""))
        normals = orient_normals(merged["points"], normals, like=known_sides(given, sensor))
    cloud = given.replaced(merged["points"], normals, metadata=metadata)
    if parameters.get("diagnostics"):
        cloud = with_columns(cloud, found.columns())
    warnings = list(cloud.warnings)
    results = {}
    for name in dict.fromkeys((given.flavour.format, *STORED)):
        file = own_name(f"result.{name}")
        try:
            with writing(runtime.storage, job_file(job.id, file)) as path:
                notes = write(path, cloud, format=name, coordinates=parameters.get("coordinates", "keep"))
                facts = result_facts(path, file)
        except PcdnfError as error:
            if name == given.flavour.format:
                raise
            # This format cannot hold everything this file carries.
            warnings.append(f"The result is not available as {FORMATS[name].title}. {error}")
            continue
        warnings += notes
        results[name] = facts
    with writing(runtime.storage, job_file(job.id, DISPLAY)) as path:
        write_display(
            path,
            before=given.points,
            after=merged["points"],
            raw_normals=first["normals"],
            normals=normals,
            colour=colours(given),
            shares=found.shares(),
        )
    flagged = int(merged["flagged"].sum())
    if flagged:
        warnings.append(f"{flagged} points have too few neighbours and are returned unchanged.")
    return {"results": results, "warnings": warnings}
