"""Around every request: how many at a time, and the headers every response carries."""

from __future__ import annotations

from fastapi import Request
from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from .pages import POLICY
from .problems import Problem

ALWAYS = ("/livez", "/readyz")  # answered however busy the service is
HEADERS = {
    "Content-Security-Policy": POLICY,
    "Referrer-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
}
"""On every response, unless the route set its own."""


class Guard:
    """Answers 503 beyond `max_requests` at a time, and tells browsers what they may not do.

    Parameters
    ----------
    app : ASGI application
    max_requests : int
    """

    def __init__(self, app: ASGIApp, max_requests: int) -> None:
        self._app = app
        self._max = max_requests
        self._running = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        if self._running >= self._max and scope["path"] not in ALWAYS:
            problem = Problem(
                "too_busy",
                f"The service is already answering {self._running} requests.",
                headers={"Retry-After": "2"},
                limit=self._max,
            )
            await problem.response(Request(scope))(scope, receive, guarded)
            return
        self._running += 1
        try:
            await self._app(scope, receive, guarded)
        finally:
            self._running -= 1
