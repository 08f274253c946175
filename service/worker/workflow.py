"""The durable workflows of a job and of a shard of a large job.

After a crash DBOS runs the workflow again from the top. Every finished step returns its checkpoint, so the work
continues at the first missing tile. If several workers are ready, the tiles of a large cloud are divided into shards.
Each shard is a workflow of its own, on a queue of all workers. The job waits for its shards before it merges them.
"""

from __future__ import annotations

import logging
from typing import Any

from dbos import DBOS, SetWorkflowID
from dbos import error as dbos_error

from ..jobs.attempts import MAX_CRASHES
from ..jobs.dbos_contract import SHARD_WORKFLOW, WORKFLOW
from ..jobs.job import Job
from ..jobs.lanes import SHARDS_QUEUE
from ..jobs.shards import Part, shard_id
from .context import runtime
from .prepared import DIFFERS, Pass
from .steps import Outcome, denoise_tile, finish, gather, merge, plan, problem_of, result_files, survey, sweep

log = logging.getLogger(__name__)

MAX_DISPATCHES = 1000  # a backstop of the engine; our own count of crashes ends a bad job long before


class JobEndedError(Exception):
    """The job ends here: cancelled, or with a problem."""

    def __init__(self, problem: dict[str, Any] | None = None) -> None:
        super().__init__()
        self.problem = problem


@DBOS.workflow(name=WORKFLOW, max_recovery_attempts=MAX_DISPATCHES)
def denoise(job_id: str) -> str:
    """Run a job to its end and return its last status."""
    with runtime().working_on(job_id, job_id):
        job = runtime().attempts.acquire(job_id)
        if job is None:
            sweep(job_id)  # the worker that ended it may have crashed before it removed the files
            return "gone"
        with runtime().attempt(job):
            try:
                return _run(job)
            except JobEndedError as end:
                return _end(job, end.problem)
            except Exception as error:
                return _end(job, _failure(job_id, error))


@DBOS.workflow(name=SHARD_WORKFLOW, max_recovery_attempts=MAX_DISPATCHES)
def denoise_shard(job_id: str, iteration: int, before: str | None, order: int | None, tiles: Part) -> Outcome:
    """Denoise a shard of a job's tiles; return their files, or that this worker does not compute as the job's does."""
    shard = shard_id(job_id, iteration, tiles[0][0])
    with runtime().working_on(shard, job_id):
        job = runtime().shards.acquire(shard)
        if job is None:
            return {"stopped": True}
        with runtime().attempt(job):
            outcome = _shard(job, Pass(iteration, before, order), tiles)
        runtime().shards.release(shard)
        return outcome


def _shard(job: Job, now: Pass, tiles: Part) -> Outcome:
    if not runtime().peers.computes_alike(job):
        return {"declined": True}
    try:
        _check_crashes(job)
        return {"files": _one_by_one(job, now, tiles)}
    except JobEndedError as end:
        if end.problem is None:
            sweep(job.id)
            return {"stopped": True}
        return {"declined": True} if end.problem["code"] == DIFFERS else {"problem": end.problem}
    except Exception as error:
        return {"problem": _failure(job.id, error)}


def _failure(job_id: str, error: Exception) -> dict[str, Any]:
    """Return the problem of a job that failed with `error`; raise the control errors of DBOS again."""
    if isinstance(error, dbos_error.DBOSException) and not isinstance(error, dbos_error.DBOSMaxStepRetriesExceeded):
        sweep(job_id)
        raise error  # for example, another worker has taken over this job
    log.error("job %s failed", job_id, exc_info=error)
    return problem_of("internal_error")


def _check_crashes(job: Job) -> None:
    if job.crashes >= MAX_CRASHES:
        detail = f"The worker process crashed {job.crashes} times at the same place of this job."
        raise JobEndedError(
            problem_of("worker_lost", detail, "Submit a smaller cloud. If that works, please report this one.")
        )


def _run(job: Job) -> str:
    if job.status == "cancelling":
        raise JobEndedError
    _check_crashes(job)
    merged: str | None = None  # the cloud after the last iteration
    for iteration in range(_checked(survey(job.id))["iterations"]):
        planned = _checked(plan(job.id, iteration, merged))
        now, tiles = Pass(iteration, merged, planned.get("order")), planned["tiles"]
        files = _in_shards(job, now, planned["shares"]) if "shares" in planned else _one_by_one(job, now, tiles)
        runtime().in_flight.pause_if_stopping(job.work)
        merged = _checked(merge(job.id, now, tiles, files))["file"]
    outcome = _checked(finish(job.id, merged))
    results = outcome["results"]
    if not runtime().attempts.succeed(job.id, results, outcome["warnings"]):
        raise JobEndedError
    runtime().storage.delete_job(job.id, keep=result_files(results))
    log.info("job %s succeeded", job.id)
    return "succeeded"


def _one_by_one(job: Job, now: Pass, tiles: Part) -> list[str]:
    files = []
    for start, stop in tiles:
        runtime().in_flight.pause_if_stopping(job.work)
        files.append(_checked(denoise_tile(job.id, now, start, stop, job.shard))["file"])
    return files


def _in_shards(job: Job, now: Pass, parts: list[Part]) -> list[str]:
    """Have the tiles denoised by whichever workers take them, and wait for all."""
    ids = [shard_id(job.id, now.iteration, part[0][0]) for part in parts]
    for shard, part in zip(ids, parts, strict=True):
        with SetWorkflowID(shard):
            DBOS.enqueue_workflow(SHARDS_QUEUE, denoise_shard, job.id, now.iteration, now.before, now.order, part)
    log.info("job %s iteration %d in %d shares", job.id, now.iteration, len(parts))
    files: list[str] = []
    for part, outcome in zip(parts, _checked(gather(job.id, ids))["outcomes"], strict=True):
        files += outcome["files"] if "files" in outcome else _one_by_one(job, now, part)
    return files


def _end(job: Job, problem: dict[str, Any] | None) -> str:
    attempts = runtime().attempts
    if problem is not None and attempts.fail(job.id, problem | {"instance": f"/jobs/{job.id}"}):
        status = "failed"
    elif attempts.cancel(job.id):
        status = "cancelled"
    else:
        sweep(job.id)
        return "gone"  # another worker ended it
    runtime().storage.delete_job(job.id)
    log.info("job %s %s%s", job.id, status, f": {problem['code']}" if problem else "")
    return status


def _checked(outcome: Outcome) -> Outcome:
    if "stopped" in outcome or "problem" in outcome:
        raise JobEndedError(outcome.get("problem"))
    return outcome
