"""The limit of simultaneous requests, and the headers of every response."""

from __future__ import annotations

import logging

from fastapi import Request
from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ...problems import Problem, unexpected
from ..error_handlers import respond
from ..shutdown import Shutdown

POLICY = "default-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; object-src 'none'"
"""The ``Content-Security-Policy`` of every response."""

log = logging.getLogger(__name__)

ALWAYS = (
    "/livez",
    "/readyz",
    "/v2/health/live",
    "/v2/health/ready",
    "/metrics",
)  # answered however busy the service is
HEADERS = {
    "Content-Security-Policy": POLICY,
    "Referrer-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
}
"""On every response, unless the route set its own."""


class Guard:
    """Answers 503 above `max_requests` at a time, and sets the security headers.

    Parameters
    ----------
    app : ASGI application
    max_requests : int
    shutdown : Shutdown
        Counts the requests in flight.
    """

    def __init__(self, app: ASGIApp, max_requests: int, shutdown: Shutdown) -> None:
        self._app = app
        self._shutdown = shutdown
        self._max = max_requests
        self._running = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one connection (ASGI)."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        begun = False

        async def guarded(message: Message) -> None:
            nonlocal begun
            if message["type"] == "http.response.start":
                begun = True
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        if self._running >= self._max and scope["path"] not in ALWAYS:
            problem = Problem(
                "too_busy",
                f"The service is already answering {self._running} requests, its limit.",
                hint="Send the request again after the number of seconds in Retry-After.",
                headers={"Retry-After": "2"},
                limit=self._max,
            )
            await respond(problem, Request(scope))(scope, receive, guarded)
            return
        counts = not self._shutdown.begun
        self._running += 1
        self._shutdown.in_flight += counts
        try:
            await self._app(scope, receive, guarded)
        except Exception:
            log.exception("the request met an error of the service")
            if begun:
                raise  # the server cuts the response off, so that it does not look complete
            await respond(unexpected(), Request(scope))(scope, receive, guarded)
        finally:
            self._running -= 1
            self._shutdown.in_flight -= counts
