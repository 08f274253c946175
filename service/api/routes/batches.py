"""Routes of batches: the jobs of one request with several files."""

from __future__ import annotations

from itertools import chain
from typing import Annotated

from fastapi import APIRouter, Depends, Response
from fastapi.responses import StreamingResponse

from ...jobs.job import Job
from ...problems import Problem, job_expired
from ..auth import caller
from ..intake.parameters import only_query
from ..openapi import ARCHIVE, BATCH, errors
from ..results.archive import archive
from ..schemas import BatchView, batch_view, retry_after
from ..state import State, StateIn

router = APIRouter(tags=["jobs"])


def _jobs(batch_id: str, state: StateIn, owner: Annotated[str, Depends(caller)]) -> list[Job]:
    jobs = [job for job in state.jobs.batch(batch_id, owner) if not state.jobs.expired(job)]
    if not jobs:
        raise Problem(
            "batch_not_found",
            "You have no batch with this id.",
            hint="Check the id. A batch is removed with the last of its jobs.",
        )
    return jobs


JobsIn = Annotated[list[Job], Depends(_jobs)]


@router.get(
    "/batches/{batch_id}",
    response_model=BatchView,
    dependencies=[Depends(only_query())],
    responses=errors(*BATCH),
)
def batch(response: Response, state: StateIn, batch_id: str, jobs: JobsIn) -> BatchView:
    """Return the jobs of a batch, in the order of their files."""
    response.headers["Cache-Control"] = "private, no-cache"
    live = [job for job in jobs if job.live]
    if live:
        response.headers["Retry-After"] = _wait(state, live)
    return shown(state, batch_id, jobs)


@router.get(
    "/batches/{batch_id}/results",
    response_class=Response,
    dependencies=[Depends(only_query())],
    responses=ARCHIVE | errors(*BATCH, "job_not_finished", "job_expired", "storage_unavailable"),
)
def results(state: StateIn, batch_id: str, jobs: JobsIn) -> Response:
    """Return one zip archive with the results in their own formats, and `problems.json` if jobs have none."""
    live = [job for job in jobs if job.live]
    if live:
        raise Problem(
            "job_not_finished",
            f"{len(live)} of the {len(jobs)} jobs of the batch are not finished.",
            hint="Ask again after the number of seconds in Retry-After, or cancel them.",
            headers={"Retry-After": _wait(state, live)},
            limit=0,
            actual=len(live),
        )
    body = archive(jobs, state.storage)
    try:
        first = next(body)  # opens the first file
    except FileNotFoundError:
        raise job_expired() from None

    headers = {"Content-Disposition": f'attachment; filename="batch-{batch_id[:8]}.zip"', "Cache-Control": "private"}
    return StreamingResponse(chain([first], body), headers=headers, media_type="application/zip")


def shown(state: State, batch_id: str, jobs: list[Job]) -> BatchView:
    """Return the JSON of a batch."""
    return batch_view(batch_id, [(job, state.jobs.eta(job)) for job in jobs])


def _wait(state: State, live: list[Job]) -> str:
    """Return the seconds after which to ask again: until the last job may have ended."""
    return max((retry_after(state.jobs.eta(job)) for job in live), key=int)
