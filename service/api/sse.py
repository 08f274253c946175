"""A job as a stream of server-sent events (WHATWG HTML, section 9.2).

Every event contains the whole job, so a caller that missed one has lost nothing. The id of an event identifies the
state of the job. A caller that reconnects with ``Last-Event-ID`` gets an event only if the job has changed since.
"""

from __future__ import annotations

import time
from collections.abc import AsyncIterator

from fastapi.responses import StreamingResponse
from fastapi.sse import format_sse_event

from ..jobs.eta import Eta
from ..jobs.job import Job
from .schemas import job_view
from .watch import Follower

HEARTBEAT_SECONDS = 15.0
RECONNECT_MS = 2000
HEADERS = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}  # a proxy that collects events makes them late


def event_id(job: Job, eta: Eta) -> str:
    """Return an id for this state of a job."""
    planned = "-planned" if "plan" in (job.execution or {}) else ""  # with it the corrected total
    return f"{job.status}-{job.done if eta.queue_position is None else eta.queue_position}{planned}"


def respond(follower: Follower, last_id: str | None) -> StreamingResponse:
    """Return the stream of a job, from the state behind `last_id` to its end."""
    return StreamingResponse(_stream(follower, last_id), media_type="text/event-stream", headers=HEADERS)


async def _stream(follower: Follower, last_id: str | None) -> AsyncIterator[bytes]:
    sent, written = last_id, time.monotonic()
    yield format_sse_event(retry=RECONNECT_MS)
    while True:
        ended = follower.ended
        now = event_id(follower.job, follower.eta)
        if now != sent:
            sent, written = now, time.monotonic()
            data = job_view(follower.job, follower.eta).model_dump_json()
            yield format_sse_event(event="job", id=now, data_str=data)
        if ended:
            return
        if not await follower.change(max(0.0, written + HEARTBEAT_SECONDS - time.monotonic())):
            written = time.monotonic()
            yield format_sse_event(comment="alive")
