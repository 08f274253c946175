"""The durable workflow of one job, and of a share of a large one that another worker may take.

After a crash a workflow runs again from the top, every finished step answers from its checkpoint, and work goes on at
the first tile that is missing. The tiles of a large cloud are shared where several workers are there: a share is a
workflow of its own, on a queue of all workers, and the job waits for its shares before it merges them.
"""

from __future__ import annotations

import logging
from typing import Any

from dbos import DBOS, SetWorkflowID
from dbos import error as dbos_error

from ..jobs.attempts import MAX_LOSSES
from ..jobs.dbos_contract import SHARE_WORKFLOW, WORKFLOW
from ..jobs.job import Job
from ..jobs.lanes import SHARES_QUEUE
from ..jobs.shards import Part, share_id
from .prepared import DIFFERS, Pass
from .steps import Outcome, denoise_one, finish, gather, kept, merge, plan, problem_of, shared, survey, sweep
from .steps import install as install

log = logging.getLogger(__name__)

MAX_DISPATCHES = 1000  # a backstop of the engine; our own count of losses ends a bad job long before


class Ended(Exception):
    """The job ends here: cancelled, or with a problem."""

    def __init__(self, problem: dict[str, Any] | None = None) -> None:
        super().__init__()
        self.problem = problem


@DBOS.workflow(name=WORKFLOW, max_recovery_attempts=MAX_DISPATCHES)
def denoise(job_id: str) -> str:
    """Run a job to its end and return its last status."""
    with shared().working_on(job_id, job_id, shared().attempts):
        job = shared().attempts.open(job_id)
        if job is None:
            sweep(job_id)  # who ended it may have died before its files went
            return "gone"
        with shared().attempt(job):
            try:
                return _run(job)
            except Ended as end:
                return _end(job, end.problem)
            except Exception as error:
                return _end(job, _failure(job_id, error))


@DBOS.workflow(name=SHARE_WORKFLOW, max_recovery_attempts=MAX_DISPATCHES)
def denoise_share(job_id: str, iteration: int, before: str | None, order: int | None, tiles: Part) -> Outcome:
    """Denoise a share of a job's tiles; return their files, or that this worker does not compute as the job's does."""
    share = share_id(job_id, iteration, tiles[0][0])
    with shared().working_on(share, job_id, shared().shares):
        job = shared().shares.open(share)
        if job is None:
            return {"stopped": True}
        with shared().attempt(job):
            outcome = _share(job, Pass(iteration, before, order), tiles)
        shared().shares.park(share)
        return outcome


def _share(job: Job, now: Pass, tiles: Part) -> Outcome:
    if not shared().computes_alike(job):
        return {"declined": True}
    try:
        _check_losses(job)
        return {"files": _one_by_one(job, now, tiles)}
    except Ended as end:
        if end.problem is None:
            sweep(job.id)
            return {"stopped": True}
        return {"declined": True} if end.problem["code"] == DIFFERS else {"problem": end.problem}
    except Exception as error:
        return {"problem": _failure(job.id, error)}


def _failure(job_id: str, error: Exception) -> dict[str, Any]:
    """Return the problem of a job that met an error; raise again what is the engine's own affair."""
    if isinstance(error, dbos_error.DBOSException) and not isinstance(error, dbos_error.DBOSMaxStepRetriesExceeded):
        sweep(job_id)
        raise error  # such as another worker having taken this job over
    log.error("job %s failed", job_id, exc_info=error)
    return problem_of("internal_error")


def _check_losses(job: Job) -> None:
    if job.losses >= MAX_LOSSES:
        detail = f"The worker process died {job.losses} times at the same place of this job, which was then given up."
        raise Ended(problem_of("worker_lost", detail, "Send a smaller cloud; if that works, please report this one."))


def _run(job: Job) -> str:
    if job.status == "cancelling":
        raise Ended
    _check_losses(job)
    merged: str | None = None  # the cloud after the last iteration
    for iteration in range(_checked(survey(job.id))["iterations"]):
        planned = _checked(plan(job.id, iteration, merged))
        now, tiles = Pass(iteration, merged, planned.get("order")), planned["tiles"]
        files = _shared_out(job, now, planned["shares"]) if "shares" in planned else _one_by_one(job, now, tiles)
        shared().pause_if_stopping(job.work)
        merged = _checked(merge(job.id, now, tiles, files))["file"]
    outcome = _checked(finish(job.id, merged))
    results = outcome["results"]
    if not shared().attempts.succeed(job.id, results, outcome["warnings"]):
        raise Ended
    shared().storage.delete_job(job.id, keep=kept(results))
    log.info("job %s succeeded", job.id)
    return "succeeded"


def _one_by_one(job: Job, now: Pass, tiles: Part) -> list[str]:
    files = []
    for start, stop in tiles:
        shared().pause_if_stopping(job.work)
        files.append(_checked(denoise_one(job.id, now, start, stop, job.share))["file"])
    return files


def _shared_out(job: Job, now: Pass, parts: list[Part]) -> list[str]:
    """Have the tiles denoised by whichever workers take them, and wait for all."""
    ids = [share_id(job.id, now.iteration, part[0][0]) for part in parts]
    for share, part in zip(ids, parts, strict=True):
        with SetWorkflowID(share):
            DBOS.enqueue_workflow(SHARES_QUEUE, denoise_share, job.id, now.iteration, now.before, now.order, part)
    log.info("job %s iteration %d in %d shares", job.id, now.iteration, len(parts))
    files: list[str] = []
    for part, outcome in zip(parts, _checked(gather(job.id, ids))["outcomes"], strict=True):
        files += outcome["files"] if "files" in outcome else _one_by_one(job, now, part)
    return files


def _end(job: Job, problem: dict[str, Any] | None) -> str:
    attempts = shared().attempts
    if problem is not None and attempts.fail(job.id, problem | {"instance": f"/jobs/{job.id}"}):
        status = "failed"
    elif attempts.cancel(job.id):
        status = "cancelled"
    else:
        sweep(job.id)
        return "gone"  # another worker ended it
    shared().storage.delete_job(job.id)
    log.info("job %s %s%s", job.id, status, f": {problem['code']}" if problem else "")
    return status


def _checked(outcome: Outcome) -> Outcome:
    if "stopped" in outcome or "problem" in outcome:
        raise Ended(outcome.get("problem"))
    return outcome
