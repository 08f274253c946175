"""From a request to a job: receive the upload, check it, queue it."""

from __future__ import annotations

import logging
from pathlib import Path

import sqlalchemy as sa
from fastapi import Request
from starlette.concurrency import run_in_threadpool

from ...jobs.admission import Load
from ...jobs.files import UPLOAD, job_file
from ...jobs.job import Job, new_id
from ...problems import Problem
from ...telemetry import logs
from ..middleware.access_log import timed
from ..state import State
from .idempotency import Claim, Claims, fingerprint, idempotency_key
from .parameters import Parameters, job_parameters
from .upload import Upload, declared_bytes, receive

log = logging.getLogger(__name__)


async def accept(request: Request, state: State, owner: str) -> Job:
    """Stream the upload to disk, have it checked, and queue it; or return the job of an earlier, equal request.

    Raises
    ------
    Problem
        For everything a caller can do wrong, and for want of room.
    """
    settings = state.settings
    state.shutdown.check_open()
    query = request.query_params.multi_items()
    job_parameters(query, settings)  # before the body is read
    async with state.claims.held(owner, idempotency_key(request)) as claim:
        expected = min(declared_bytes(request), settings.max_upload_bytes)
        fresh = claim is None or claim.job is None
        if fresh:  # before the body is read
            await run_in_threadpool(state.jobs.check_room, owner, Load(1, expected, 1))
            await run_in_threadpool(state.retention.make_room, expected)
        path = state.storage.scratch()
        with timed("upload", state.metrics):
            upload = await receive(request, path, settings)
        try:
            if fresh and upload.size > expected:  # its length was unknown; now the file counts as used
                await run_in_threadpool(state.retention.make_room)
            parameters = job_parameters([*query, *upload.fields], settings)
            if claim is not None and claim.job is not None:
                return await run_in_threadpool(_replay, state, claim, upload, parameters)
            return await _queue(state, owner, path, upload, parameters, claim)
        finally:
            path.unlink(missing_ok=True)


def _replay(state: State, claim: Claim, upload: Upload, parameters: Parameters) -> Job:
    """Return the job that an equal request made before."""
    claim.check(fingerprint(upload.sha256, upload.name, parameters.model_dump()))
    assert claim.job is not None
    job = state.jobs.status(claim.job, claim.owner)
    if job is None or state.jobs.expired(job):
        raise Problem(
            "job_expired",
            "The job that was created with this key has expired and its files were removed.",
            hint="Submit the file again with a new key.",
        )
    return job


async def _queue(
    state: State, owner: str, path: Path, upload: Upload, parameters: Parameters, claim: Claim | None
) -> Job:
    with timed("check", state.metrics):
        found = await state.inspector.inspect(path, parameters, text=upload.is_text)
    job_id = new_id()

    def bind(connection: sa.Connection) -> None:
        if claim is not None:
            mark = fingerprint(upload.sha256, upload.name, parameters.model_dump())
            Claims.bind(connection, claim, job_id, mark)

    def submit() -> Job:
        try:
            with timed("store", state.metrics):
                state.storage.put(path, job_file(job_id, UPLOAD))
            with timed("queue", state.metrics):
                return state.jobs.submit(
                    job_id,
                    owner=owner,
                    parameters=parameters.model_dump(),
                    upload={
                        "name": upload.name,
                        "format": found.format,
                        "bytes": upload.size,
                        "points": found.points,
                        "has_normals": found.has_normals,
                    },
                    warnings=found.warnings,
                    also=bind,
                )
        except (Problem, OSError):  # refused, or the disk is full: nothing was committed
            state.storage.delete_job(job_id)
            raise

    with logs.about(job_id=job_id):
        job = await run_in_threadpool(submit)
        log.info("accepted %d points as %s, %d bytes", found.points, found.format, upload.size)
        return job
