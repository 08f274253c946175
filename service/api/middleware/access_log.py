"""The access log: for every request an id, a trace, a line, the metrics and ``Server-Timing``."""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ...telemetry import logs, tracing
from ..metrics import ApiMetrics

log = logging.getLogger(__name__)

HEADER = "X-Request-ID"
_ID = re.compile(r"[A-Za-z0-9._:-]{1,128}")
METHODS = ("DELETE", "GET", "HEAD", "OPTIONS", "PATCH", "POST", "PUT")
QUIET = ("/livez", "/readyz", "/metrics", "/v2/health/live", "/v2/health/ready")  # logged at level debug
POLLED = ("/jobs/{job_id}", "/batches/{batch_id}")  # also, if they were answered well
UNKNOWN = "none"  # the route of a request that met none; its path is the caller's own words

_timings: ContextVar[dict[str, float] | None] = ContextVar("timings", default=None)


@contextmanager
def timed(stage: str, metrics: ApiMetrics) -> Iterator[None]:
    """Time a stage of the request: as a span, for the metrics and in the answer's ``Server-Timing``."""
    began = time.perf_counter()
    try:
        with tracing.span(stage):
            yield
    finally:
        seconds = time.perf_counter() - began
        metrics.submission_stage.labels(stage).observe(seconds)
        timings = _timings.get()
        if timings is not None:
            timings[stage] = timings.get(stage, 0.0) + seconds


class AccessLog:
    """Sees every request come and go.

    Parameters
    ----------
    app : ASGI application
    metrics : ApiMetrics
    """

    def __init__(self, app: ASGIApp, metrics: ApiMetrics) -> None:
        self._app = app
        self._metrics = metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one connection (ASGI)."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        request_id = headers.get(HEADER, "")
        if not _ID.fullmatch(request_id):
            request_id = logs.fresh_id()
        method = scope["method"] if scope["method"] in METHODS else "other"
        began = time.perf_counter()
        timings: dict[str, float] = {}
        token = _timings.set(timings)
        status = 0

        async def observed(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                answer = MutableHeaders(scope=message)
                answer[HEADER] = request_id
                stages = timings | {"total": time.perf_counter() - began}
                answer["Server-Timing"] = ", ".join(f"{name};dur={1000 * t:.1f}" for name, t in stages.items())
            await send(message)

        try:
            with (
                logs.about(request_id=request_id),
                tracing.span(method, carrier=headers, server=True) as span,
                self._metrics.requests_in_progress.track_inprogress(),
            ):
                try:
                    await self._app(scope, receive, observed)
                finally:
                    route = _route(scope)
                    seconds = time.perf_counter() - began
                    self._metrics.request_duration.labels(method, route, status or "none").observe(seconds)
                    attributes = {
                        "http.request.method": method,
                        "http.route": route,
                        "http.response.status_code": status,
                    }
                    span.update_name(f"{method} {route}")
                    span.set_attributes(attributes)
                    self._log_request(scope, attributes, seconds)
        finally:
            _timings.reset(token)

    def _log_request(self, scope: Scope, attributes: dict[str, str | int], seconds: float) -> None:
        method, route, status = attributes.values()
        job = scope.get("path_params", {}).get("job_id")
        with logs.about(**({"job_id": job} if job and _ID.fullmatch(job) else {})):
            log.log(
                logging.DEBUG if _is_quiet(attributes) else logging.INFO,
                "%s %s %s in %.3f s",
                method,
                route,
                status or "was broken off",
                seconds,
                extra={logs.ATTRIBUTES: attributes | {"duration": round(seconds, 6)}},
            )


def _is_quiet(attributes: dict[str, str | int]) -> bool:
    """Return whether a request is one of many, such as a poll: it would hide the others in the log."""
    method, route, status = attributes.values()
    return route in QUIET or (method == "GET" and route in POLLED and status in (200, 304))


def _route(scope: Scope) -> str:
    """Return the template of the route, such as ``/jobs/{job_id}``; a finite set."""
    path = getattr(scope.get("route"), "path", None)
    if path is None and scope.get("root_path"):
        return str(scope["root_path"])  # a mounted folder
    return str(path or UNKNOWN)
