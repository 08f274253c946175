"""From a request to jobs: receive the upload, check it, queue it."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import sqlalchemy as sa
from fastapi import Request
from starlette.concurrency import run_in_threadpool

from ...jobs.admission import Load
from ...jobs.files import UPLOAD, job_file
from ...jobs.job import Job, new_id
from ...jobs.store import NewJob
from ...problems import Problem
from ...telemetry import logs
from ..middleware.access_log import timed
from ..state import State
from .idempotency import Claim, Claims, fingerprint, idempotency_key
from .inspection import Inspection
from .parameters import Parameters, job_parameters
from .upload import FILE_NAME, Received, Upload, declared_bytes, receive

log = logging.getLogger(__name__)


@dataclass
class Checked:
    """A file that was checked, and where its cloud lies."""

    upload: Upload
    found: Inspection
    path: Path
    id: str


async def accept(request: Request, state: State, owner: str) -> list[Job]:
    """Stream the upload to disk, have it checked, and queue it; or return the jobs of an earlier, equal request.

    Returns
    -------
    list of Job
        One for each file; several files are a batch.

    Raises
    ------
    Problem
        For everything a caller can do wrong, and for want of room.
    """
    settings = state.settings
    state.shutdown.check_open()
    query = [(name, value) for name, value in request.query_params.multi_items() if name != FILE_NAME]
    job_parameters(query, settings)  # before the body is read
    async with state.claims.held(owner, idempotency_key(request)) as claim:
        expected = min(declared_bytes(request), settings.upload_limit)
        fresh = claim is None or claim.job is None
        if fresh:  # before the body is read
            await run_in_threadpool(state.jobs.check_room, owner, Load(1, expected, 1))
            await run_in_threadpool(state.retention.make_room, expected)
        with timed("upload", state.metrics):
            received = await receive(request, state.storage.scratch, settings)
        try:
            if fresh and sum(upload.size for upload in received.files) > expected:  # now the files count as used
                await run_in_threadpool(state.retention.make_room)
            parameters = job_parameters([*query, *received.fields], settings)
            if claim is not None and claim.job is not None:
                return await run_in_threadpool(_replay, state, claim, received, parameters)
            return await _queue(state, owner, received, parameters, claim)
        finally:
            for upload in received.files:
                upload.path.unlink(missing_ok=True)


def _mark(received: Received, parameters: Parameters) -> str:
    """Return what distinguishes this request from others."""
    files = [(upload.sha256, upload.name) for upload in received.files]
    if len(files) == 1:
        return fingerprint(*files[0], parameters.in_force())
    return fingerprint(" ".join(digest for digest, _ in files), "/".join(name for _, name in files),
                       parameters.in_force())  # fmt: skip


def _replay(state: State, claim: Claim, received: Received, parameters: Parameters) -> list[Job]:
    """Return the jobs that an equal request made before."""
    claim.check(_mark(received, parameters))
    assert claim.job is not None
    job = state.jobs.status(claim.job, claim.owner)
    if job is None or state.jobs.expired(job):
        raise Problem(
            "job_expired",
            "The job that was created with this key has expired and its files were removed.",
            hint="Submit the file again with a new key.",
        )
    return [job] if job.batch is None else state.jobs.batch(job.batch, claim.owner)


async def _queue(
    state: State, owner: str, received: Received, parameters: Parameters, claim: Claim | None
) -> list[Job]:
    clouds: list[Path] = []
    try:
        checked = []
        for upload in received.files:
            clouds.append(state.storage.scratch())
            with timed("check", state.metrics), _naming(upload, received):
                found = await state.inspector.inspect(
                    upload.path, parameters, text=upload.is_text, unpack_to=clouds[-1]
                )
            path = upload.path if found.unpacked is None else clouds[-1]
            checked.append(Checked(upload, found, path, new_id()))
        if any(each.found.unpacked is not None for each in checked):
            await run_in_threadpool(state.retention.make_room)
        ids = {"job_id": checked[0].id} if len(checked) == 1 else {}
        with logs.about(**ids):
            jobs = await run_in_threadpool(
                _submit, state, owner, checked, parameters, claim, _mark(received, parameters)
            )
            for each in checked:
                log.info("accepted %d points as %s", each.found.points, each.found.format)
        return jobs
    finally:
        for cloud in clouds:
            cloud.unlink(missing_ok=True)


@contextmanager
def _naming(upload: Upload, received: Received) -> Iterator[None]:
    """Say in a problem which of several files has it."""
    try:
        yield
    except Problem as problem:
        if len(received.files) > 1:
            problem.detail = f"File {received.files.index(upload) + 1}, {upload.name}: {problem.detail}"
            problem.members["file"] = received.files.index(upload) + 1
        raise


def _submit(
    state: State, owner: str, checked: list[Checked], parameters: Parameters, claim: Claim | None, mark: str
) -> list[Job]:
    def bind(connection: sa.Connection) -> None:
        if claim is not None:
            Claims.bind(connection, claim, checked[0].id, mark)

    try:
        with timed("store", state.metrics):
            for each in checked:
                state.storage.put(each.path, job_file(each.id, UPLOAD))
        with timed("queue", state.metrics):
            return state.jobs.submit_all(
                [NewJob(each.id, _facts(each), each.found.warnings) for each in checked],
                owner=owner,
                parameters=parameters.in_force(),
                batch=new_id() if len(checked) > 1 else None,
                also=bind,
            )
    except (Problem, OSError):  # refused, or the disk is full: nothing was committed
        for each in checked:
            state.storage.delete_job(each.id)
        raise


def _facts(checked: Checked) -> dict[str, str | int | bool]:
    upload, found = checked.upload, checked.found
    return {
        "name": upload.name,
        "format": found.format,
        "bytes": upload.size if found.unpacked is None else found.unpacked,
        "points": found.points,
        "has_normals": found.has_normals,
    }
