"""Routes of jobs."""

from __future__ import annotations

import hashlib
from collections.abc import AsyncIterator
from typing import Annotated
from urllib.parse import urlencode

from fastapi import APIRouter, Depends, Header, Query, Request, Response
from fastapi.responses import JSONResponse, StreamingResponse
from pydantic import AfterValidator, BeforeValidator, Field
from starlette.concurrency import run_in_threadpool

from pcdnf.file_formats import FORMATS

from ... import problems
from ...jobs.job import FINISHED, Job
from ...problems import Problem
from .. import sse
from ..auth import caller
from ..intake.parameters import only_query
from ..intake.submission import accept
from ..openapi import (
    CALLER,
    CANCELLED,
    DELETED,
    DENOISE_BODY,
    DENOISE_PARAMETERS,
    DENOISED,
    DISPLAY_RESPONSES,
    EVENTS,
    JOB,
    LISTED,
    NOT_MODIFIED,
    RESULT_RESPONSES,
    errors,
)
from ..results import download
from ..schemas import JobView, Status, job_view, retry_after
from ..state import State, StateIn
from ..watch import Follower, preferred_wait
from . import batches

PAGE = 100  # most jobs in one response
NOT_FOUND_HINT = "Check the id. A job is removed 30 days after it has expired."
NOT_FINISHED_HINT = "Ask again after the number of seconds in Retry-After, or follow GET /jobs/{id}/events."


def _job(job_id: str, state: StateIn, owner: Annotated[str, Depends(caller)]) -> Job:
    job = state.jobs.status(job_id, owner)
    if job is None:
        raise Problem("job_not_found", "You have no job with this id.", hint=NOT_FOUND_HINT)
    if state.jobs.expired(job):
        raise problems.job_expired()
    return job


CallerIn = Annotated[str, Depends(caller)]


JobIn = Annotated[Job, Depends(_job)]


async def _follower(state: StateIn, job: JobIn) -> AsyncIterator[Follower]:
    eta = await run_in_threadpool(state.jobs.eta, job)
    with state.watch.following(job, eta) as follower:
        yield follower  # until the response has been sent


FollowerIn = Annotated[Follower, Depends(_follower)]


def _known_format(name: str) -> str:
    if name.lower() not in FORMATS:
        raise ValueError(f"must be one of {', '.join(FORMATS)}")
    return name.lower()


StatusIn = Annotated[Status, BeforeValidator(lambda text: text.lower() if isinstance(text, str) else text)]


router = APIRouter(tags=["jobs"])


@router.post(
    "/denoise",
    status_code=202,
    response_model=JobView,
    responses=DENOISED,
    openapi_extra={"requestBody": DENOISE_BODY, "parameters": DENOISE_PARAMETERS},
)
async def denoise(request: Request, state: StateIn, owner: CallerIn) -> Response:
    """Take a cloud, or a form with several, and queue it; parameters stand in the query or in the form."""
    accepted = await accept(request, state, owner)
    job = accepted[0]
    if job.batch is not None:
        view = await run_in_threadpool(batches.shown, state, job.batch, accepted)
        return JSONResponse(
            view.model_dump(mode="json"), status_code=201, headers={"Location": f"/batches/{job.batch}"}
        )
    seconds = preferred_wait(request, state.settings.max_wait_seconds)
    waits = seconds is not None and not state.watch.full
    if waits:
        job = await state.watch.finished(job, float(seconds or 0))
    response = await run_in_threadpool(_shown, request, state, job, 202 if job.live or not waits else 200)
    response.headers["Location"] = f"/jobs/{job.id}"
    if waits:
        response.headers["Preference-Applied"] = f"wait={seconds}"
    return response


@router.get(
    "/jobs",
    dependencies=[Depends(only_query("limit", "before", "status", "name"))],
    responses=LISTED | errors(*CALLER, "invalid_parameters"),
)
def jobs(
    response: Response,
    state: StateIn,
    owner: CallerIn,
    limit: Annotated[int, Query(ge=1, le=PAGE, description="Most jobs returned")] = 20,
    before: Annotated[str | None, Query(description="Only jobs older than this one")] = None,
    status: Annotated[list[StatusIn] | None, Query(description="Only jobs with one of these")] = None,
    name: Annotated[str | None, Query(max_length=100, description="Only jobs with this in the name")] = None,
) -> list[JobView]:
    """Return the caller's own jobs, newest first."""
    last = None if before is None else state.jobs.status(before, owner)
    if before is not None and last is None:
        raise Problem("invalid_parameters", "before: you have no job with this id.", hint=NOT_FOUND_HINT)
    page, total = state.jobs.page(owner, limit=limit + 1, before=last, statuses=status or (), name=name)
    response.headers["X-Total-Count"] = str(total)
    if len(page) > limit:
        page.pop()
        asked = [("limit", str(limit)), ("before", page[-1].id), *(("status", each) for each in status or ())]
        query = urlencode([*asked, *([("name", name)] if name is not None else [])])
        response.headers["Link"] = f'</jobs?{query}>; rel="next"'
    return [job_view(job, state.jobs.eta(job)) for job in page]


@router.get(
    "/jobs/{job_id}",
    response_model=JobView,
    dependencies=[Depends(only_query())],
    responses=NOT_MODIFIED | errors(*JOB),
)
def status(request: Request, state: StateIn, job: JobIn) -> Response:
    """Return the state of a job."""
    return _shown(request, state, job, 200)


@router.get(
    "/jobs/{job_id}/events",
    response_class=StreamingResponse,
    dependencies=[Depends(only_query())],
    responses=EVENTS | errors(*JOB),
)
async def follow(
    follower: FollowerIn,
    last_event_id: Annotated[str | None, Header(description="`id` of the last event that arrived")] = None,
) -> Response:
    """Follow a job: server-sent events named `job`, each with the whole job, until it has finished."""
    if not follower.job.live and last_event_id == sse.event_id(follower.job, follower.eta):
        return Response(status_code=204)  # the browser's EventSource stops coming back
    return sse.respond(follower, last_event_id)


@router.post(
    "/jobs/{job_id}/cancel",
    response_model=JobView,
    dependencies=[Depends(only_query())],
    responses=CANCELLED | errors(*JOB, "already_finished", "precondition_failed"),
)
def cancel(request: Request, state: StateIn, job: JobIn) -> Response:
    """Cancel a live job; a job that has just finished keeps its result, and the answer says so."""
    _check_unchanged(request, state, job)
    now = state.jobs.cancel(job) if job.live else job
    if now is None:
        raise problems.job_expired()
    if now.status in ("succeeded", "failed"):
        raise Problem(
            "already_finished",
            f"The job has already {now.status} and cannot be cancelled.",
            hint=f"GET /jobs/{now.id}/result returns its result. DELETE /jobs/{now.id} removes the job."
            if now.status == "succeeded"
            else f"DELETE /jobs/{now.id} removes the job.",
        )
    return _shown(request, state, now, 202 if now.live else 200)


@router.delete(
    "/jobs/{job_id}",
    response_model=JobView,
    dependencies=[Depends(only_query())],
    responses=DELETED | errors(*JOB, "precondition_failed", "storage_unavailable"),
)
def delete(request: Request, state: StateIn, job: JobIn) -> Response:
    """Remove a finished job, or cancel a live one and remove its upload; `cancel` never removes a result."""
    _check_unchanged(request, state, job)
    if job.status in FINISHED:
        state.jobs.remove(job)
        return Response(status_code=204)
    now = state.jobs.cancel(job)
    if now is None:
        return Response(status_code=204)
    if now.status in ("succeeded", "failed"):  # it ended before it could be cancelled
        state.jobs.remove(now)
        return Response(status_code=204)
    return _shown(request, state, now, 202 if now.live else 200)


@router.head("/jobs/{job_id}/result", include_in_schema=False, dependencies=[Depends(only_query("format"))])
@router.get(
    "/jobs/{job_id}/result",
    response_class=Response,
    dependencies=[Depends(only_query("format"))],
    responses=RESULT_RESPONSES,
)
async def result(
    request: Request,
    state: StateIn,
    job: JobIn,
    format_: Annotated[
        Annotated[str, AfterValidator(_known_format), Field(json_schema_extra={"enum": list(FORMATS)})] | None,
        Query(alias="format", description="Format of the result, in place of `Accept`"),
    ] = None,
) -> Response:
    """Return the denoised cloud, as the format that came in or as the one asked for."""
    if job.status != "succeeded":
        raise await run_in_threadpool(_no_result, state, job)
    name = download.chosen_format(request, job, format_)
    if name not in (job.results or {}):
        job = await state.converter.with_format(job, name)
    return await run_in_threadpool(download.respond, request, job, state.storage, name)


@router.get(
    "/jobs/{job_id}/display",
    response_class=Response,
    dependencies=[Depends(only_query())],
    responses=DISPLAY_RESPONSES,
)
def display(request: Request, state: StateIn, job: JobIn) -> Response:
    """Return what the page at `/` draws: at most a million points before and after, as binary glTF."""
    if job.status == "succeeded":
        return download.respond_display(request, job, state.storage)
    raise _no_result(state, job)


def _no_result(state: State, job: Job) -> Problem:
    if job.live and job.status != "cancelling":
        wait = {"Retry-After": retry_after(state.jobs.eta(job))}
        return Problem("job_not_finished", f"The job is {job.status}.", hint=NOT_FINISHED_HINT, headers=wait)
    if job.status == "failed":
        cause = job.problem or {}
        detail = f"The job failed and has no result. {cause.get('detail', '')}"
        return Problem(
            "job_failed", detail.strip(), hint=cause.get("hint") or "Submit the file again.", cause=cause.get("code")
        )
    return Problem("job_cancelled", "The job was cancelled and has no result.", hint="Submit the file again.")


def _shown(request: Request, state: State, job: Job, status: int) -> Response:
    eta = state.jobs.eta(job)
    response = JSONResponse(job_view(job, eta).model_dump(mode="json"), status_code=status)
    if job.live:
        response.headers["Retry-After"] = "1" if job.status == "cancelling" else retry_after(eta)
    if status == 200 and request.method == "GET":
        etag = _etag(bytes(response.body))
        if download.matches(request.headers.get("if-none-match"), etag):
            retry = {name: response.headers[name] for name in ("retry-after",) if name in response.headers}
            return Response(status_code=304, headers={"ETag": etag, "Cache-Control": "private, no-cache"} | retry)
        response.headers["ETag"] = etag
    response.headers["Cache-Control"] = "private, no-cache"
    return response


def _etag(body: bytes) -> str:
    return f'"{hashlib.sha256(body).hexdigest()[:32]}"'


def _check_unchanged(request: Request, state: State, job: Job) -> None:
    """Raise 412 where ``If-Match`` names another state of the job than that of now (RFC 9110, section 13.1.1)."""
    wanted = request.headers.get("if-match")
    if wanted is None or wanted.strip() == "*":
        return
    now = _etag(bytes(JSONResponse(job_view(job, state.jobs.eta(job)).model_dump(mode="json")).body))
    if now not in [tag.strip() for tag in wanted.split(",")]:
        raise Problem(
            "precondition_failed",
            "The job has changed since the state that If-Match names.",
            hint=f"Ask for GET /jobs/{job.id}, and send the ETag of its response, or leave If-Match out.",
        )
