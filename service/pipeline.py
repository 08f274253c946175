"""The durable workflow of one job: a survey; plan, tiles, merge for every iteration, then the result's files.

Each step is checkpointed by the engine: it leaves a file in storage and returns plain JSON, so that after a crash the
workflow runs again from the top, every finished step answers from its checkpoint, and work goes on at the first tile
that is missing. What the caller is to be told is returned as ``{"problem": ...}``, never raised.
"""

from __future__ import annotations

import functools
import logging
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from dbos import DBOS
from dbos import error as dbos_error
from numpy.typing import NDArray

from pcdnf.denoiser import Stopped
from pcdnf.errors import PcdnfError
from pcdnf.file_formats import FORMATS
from pcdnf.formats import write
from pcdnf.orientation import orient_normals

from . import tracing
from .attempts import MAX_LOSSES
from .display import colours, write_display
from .engine import WORKFLOW
from .job import Job
from .models import denoise_tile
from .problems import CATALOGUE, Problem
from .runtime import Runtime
from .storage import DISPLAY, UPLOAD, job_file, own_name, result_facts, result_name, writing
from .work import (
    RAW_NORMALS,
    DiskFull,
    Progress,
    form,
    load_arrays,
    merged_name,
    planned,
    prepared,
    read_upload,
    settled,
    store_arrays,
    tile_name,
    with_room,
)

log = logging.getLogger(__name__)

STORED = ("ply", "npz")  # beside the format that came in; the others are written when they are asked for
MAX_DISPATCHES = 1000  # a backstop of the engine; our own count of losses ends a bad job long before
Outcome = dict[str, Any]

_runtime: Runtime | None = None


def install(runtime: Runtime) -> None:
    """Give the workflow what it works with; once, before the engine is launched."""
    global _runtime
    _runtime = runtime


def _shared() -> Runtime:
    assert _runtime is not None
    return _runtime


class Ended(Exception):
    """The job ends here: cancelled, or with a problem."""

    def __init__(self, problem: dict[str, Any] | None = None) -> None:
        super().__init__()
        self.problem = problem


@DBOS.workflow(name=WORKFLOW, max_recovery_attempts=MAX_DISPATCHES)
def denoise(job_id: str) -> str:
    """Run a job to its end and return its last status."""
    with _shared().working_on(job_id):
        job = _shared().attempts.open(job_id)
        if job is None:
            return "gone"
        with _shared().attempt(job):
            return _attempt(job)


def _attempt(job: Job) -> str:
    try:
        return _run(job)
    except Ended as end:
        return _end(job, end.problem)
    except dbos_error.DBOSMaxStepRetriesExceeded:
        log.exception("job %s failed", job.id)
        return _end(job, problem_of("internal_error"))
    except dbos_error.DBOSException:
        _sweep(job.id)
        raise  # the engine's own affair, such as another worker having taken this job over
    except Exception:
        log.exception("job %s failed", job.id)
        return _end(job, problem_of("internal_error"))


def problem_of(code: str, detail: str | None = None, hint: str | None = None) -> dict[str, Any]:
    """Return the problem a failed job shows."""
    told = {
        "disk_full": ("The service ran out of disk space.", "Try again later."),
        "internal_error": ("The service met an error of its own.", "The log of the worker says more."),
    }
    known_detail, known_hint = told.get(code, (code, None))
    status = None if code in CATALOGUE else 422
    return Problem(code, detail or known_detail, hint=hint or known_hint, status=status).body()


def _run(job: Job) -> str:
    shared = _shared()
    if job.status == "cancelling":
        raise Ended
    if job.losses >= MAX_LOSSES:
        detail = f"The worker process died {job.losses} times at the same place of this job, which was then given up."
        raise Ended(problem_of("worker_lost", detail, "Send a smaller cloud; if that works, please report this one."))
    merged: str | None = None  # the cloud after the last iteration
    for iteration in range(_checked(survey(job.id))["iterations"]):
        files: list[str] = []
        tiles = _checked(plan(job.id, iteration, merged))["tiles"]
        for start, stop in tiles:
            shared.pause_if_stopping(job.id)
            files.append(_checked(denoise_one(job.id, iteration, merged, start, stop))["file"])
        shared.pause_if_stopping(job.id)
        merged = _checked(merge(job.id, iteration, merged, tiles, files))["file"]
    outcome = _checked(finish(job.id, merged))
    results = outcome["results"]
    if not shared.attempts.succeed(job.id, results, outcome["warnings"]):
        raise Ended
    shared.storage.delete_job(job.id, keep=_kept(results))
    log.info("job %s succeeded", job.id)
    return "succeeded"


def _end(job: Job, problem: dict[str, Any] | None) -> str:
    attempts = _shared().attempts
    if problem is not None and attempts.fail(job.id, problem | {"instance": f"/jobs/{job.id}"}):
        status = "failed"
    elif attempts.cancel(job.id):
        status = "cancelled"
    else:
        _sweep(job.id)
        return "gone"  # another worker ended it
    _shared().storage.delete_job(job.id)
    log.info("job %s %s%s", job.id, status, f": {problem['code']}" if problem else "")
    return status


def _kept(results: dict[str, Any]) -> frozenset[str]:
    return frozenset({UPLOAD, DISPLAY, *(result_name(name, facts) for name, facts in results.items())})


def _sweep(job_id: str) -> None:
    """Remove what this worker wrote for a job after another one had ended it."""
    job = _shared().attempts.get(job_id)
    if job is None or not job.live:
        results = None if job is None else job.results
        _shared().storage.delete_job(job_id, keep=_kept(results) if results else frozenset())


def _checked(outcome: Outcome) -> Outcome:
    if "stopped" in outcome or "problem" in outcome:
        raise Ended(outcome.get("problem"))
    return outcome


def _step(function: Callable[..., Outcome]) -> Callable[..., Outcome]:
    """Make `function(runtime, job, ...)` a checkpointed step that is called with the job's id."""

    @functools.wraps(function)
    def told(job_id: str, *arguments: Any) -> Outcome:
        job = _shared().attempts.get(job_id)
        if job is None or job.status != "running":
            return {"stopped": True}
        try:
            return with_room(_shared(), job_id, lambda: function(_shared(), job, *arguments))
        except Stopped:
            return {"stopped": True}
        except PcdnfError as error:
            return {"problem": problem_of(error.code, str(error), error.hint)}
        except DiskFull:
            return {"problem": problem_of("disk_full")}
        except MemoryError:
            detail = "The worker has not enough memory for this cloud."
            return {"problem": problem_of("out_of_memory", detail, "Send the cloud in parts.")}

    return DBOS.step(name=function.__name__, retries_allowed=True, max_attempts=3)(told)


@_step
def survey(runtime: Runtime, job: Job) -> Outcome:
    """Measure noise and spacing, and choose what the caller left open."""
    with runtime.at_work(job, Progress(runtime, job, 0).check), runtime.stage("survey"):
        denoiser = settled(runtime, job)
        points = read_upload(runtime, job).points
        asked = job.parameters
        chosen = denoiser.plan(
            points, iterations=asked["iterations"], radius=asked["radius"], fast=asked.get("fast", False)
        )
    execution = runtime.models.execution(job.parameters["model"]) | {"plan": chosen.to_json()}
    runtime.attempts.update(job.id, execution=execution, total=chosen.iterations * len(points))
    return {"iterations": chosen.iterations}


@_step
def plan(runtime: Runtime, job: Job, iteration: int, before: str | None) -> Outcome:
    """Prepare the cloud of an iteration and cut it into tiles."""
    cloud = prepared(runtime, job, iteration, before).cloud
    return {"tiles": [list(tile) for tile in cloud.tiles(runtime.settings.tile_points)]}


@_step
def denoise_one(runtime: Runtime, job: Job, iteration: int, before: str | None, start: int, stop: int) -> Outcome:
    """Denoise one tile and store it."""
    work = prepared(runtime, job, iteration, before)
    base = iteration * len(work.cloud)
    done, model, name = base + start, job.parameters["model"], tile_name(iteration, start)
    left = job.total - done
    with runtime.at_work(job, Progress(runtime, job, done).check, left=left) as give_way, tracing.span("tile"):
        progress = Progress(runtime, job, done, give_way)
        began = time.monotonic()
        tile = denoise_tile(work.denoiser, work.cloud, start, stop, progress=progress.report, should_stop=progress.stop)
        seconds = time.monotonic() - began - progress.lent
        runtime.measured(form(job), stop - start, seconds)
        runtime.measures.tile(model, work.denoiser.device, stop - start, work.denoiser.batch, seconds)
        store_arrays(runtime, job.id, name, points=tile.points, normals=tile.normals, flagged=tile.flagged)
        runtime.attempts.update(job.id, losses=0, done=base + stop, points_per_second=runtime.speed(form(job)))
    log.info("job %s iteration %d tile %d-%d done", job.id, iteration, start, stop)
    return {"file": name}


@_step
def merge(
    runtime: Runtime, job: Job, iteration: int, before: str | None, tiles: list[list[int]], files: list[str]
) -> Outcome:
    """Put the tiles of an iteration back into the order of the input."""
    cloud = prepared(runtime, job, iteration, before).cloud
    with runtime.at_work(job, Progress(runtime, job, (iteration + 1) * len(cloud)).check), runtime.stage("merge"):
        points, normals = np.empty((len(cloud), 3)), np.empty((len(cloud), 3), np.float32)
        flagged = np.zeros(len(cloud), bool)
        if before is None:
            store_arrays(runtime, job.id, RAW_NORMALS, normals=cloud.normals)
        else:
            flagged |= load_arrays(runtime, job.id, before)["flagged"]
        for (start, stop), file in zip(tiles, files, strict=True):
            rows = cloud.order[start:stop]
            tile = load_arrays(runtime, job.id, file)
            points[rows], normals[rows] = tile["points"], tile["normals"]
            flagged[rows] |= tile["flagged"]
        name = merged_name(iteration)
        store_arrays(runtime, job.id, name, points=points, normals=normals, flagged=flagged)
    return {"file": name}


@_step
def finish(runtime: Runtime, job: Job, last: str) -> Outcome:
    """Write the result as it came in, as PLY and as NPZ, all that repeats the run, and what the page draws."""
    with runtime.at_work(job, Progress(runtime, job, job.total).check), runtime.stage("result"):
        return _finished(runtime, job, load_arrays(runtime, job.id, last))


def _finished(runtime: Runtime, job: Job, merged: dict[str, NDArray[Any]]) -> Outcome:
    parameters = job.parameters
    plan = planned(job)
    given = read_upload(runtime, job)
    denoiser = runtime.models.get(parameters["model"])
    metadata = denoiser.metadata(seed=parameters["seed"], plan=plan)
    normals = merged["normals"]
    if parameters["orient"]:
        normals = orient_normals(merged["points"], normals, like=given.normals)
    cloud = given.replaced(merged["points"], normals, metadata=metadata)
    warnings = list(given.warnings)
    results = {}
    for name in dict.fromkeys((given.flavour.format, *STORED)):
        file = own_name(f"result.{name}")
        try:
            with writing(runtime.storage, job_file(job.id, file)) as path:
                notes = write(path, cloud, format=name)
                facts = result_facts(path, file)
        except PcdnfError as error:
            if name == given.flavour.format:
                raise
            # This format cannot hold everything this file carries.
            warnings.append(f"There is no {FORMATS[name].title} result. {error}")
            continue
        warnings += notes
        results[name] = facts
    with writing(runtime.storage, job_file(job.id, DISPLAY)) as path:
        write_display(
            path,
            before=given.points,
            after=merged["points"],
            raw_normals=load_arrays(runtime, job.id, RAW_NORMALS)["normals"],
            normals=normals,
            colour=colours(given),
        )
    lost = int(merged["flagged"].sum())
    if lost:
        warnings.append(f"{lost} points had too few neighbours and are returned as they came.")
    return {"results": results, "warnings": warnings}
