"""HTTP/1.1 with limits for slow and verbose callers, which uvicorn does not have.

The head of a request has a deadline, counted from its first byte or from the start of the connection, and a maximum
size. A connection is closed if its caller does not read the response, or continues a body after the response. If there
are too many connections, the one that has been idle longest is closed.
"""

from __future__ import annotations

import asyncio
import json
from typing import Any

from uvicorn.protocols.http.httptools_impl import STATUS_LINE, HttpToolsProtocol

from ..problems import Problem
from ..settings import Settings
from .error_handlers import MEDIA_TYPE
from .middleware.guard import HEADERS

MAX_HEADER_BYTES = 32 * 1024


class Protocol(HttpToolsProtocol):
    """One connection; made by uvicorn, whose application holds the settings."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self._settings: Settings = self.config.app.state.settings  # type: ignore[union-attr]
        self._idle_since = self.loop.time()
        self._in_head = False
        self._head_bytes = 0  # of the pieces after the one in which the head began
        self._refusal: Problem | None = None
        self._deadline: asyncio.TimerHandle | None = None
        self._stalled: asyncio.TimerHandle | None = None

    @property
    def _idle(self) -> bool:
        return self.cycle is None or self.cycle.response_complete

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Accept a connection, and close an idle one if there are too many."""
        super().connection_made(transport)
        self._limit(self._settings.header_seconds)
        if len(self.connections) > self._settings.max_connections:
            others = [other for other in self.connections if isinstance(other, Protocol) and other is not self]
            idle = [other for other in others if other._idle]
            if idle:
                min(idle, key=lambda other: other._idle_since).transport.close()
            else:
                self._refuse(
                    Problem(
                        "too_busy",
                        "The service has too many open connections.",
                        hint="Close idle connections, or try again in a few seconds.",
                        limit=self._settings.max_connections,
                    )
                )

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the deadlines."""
        self._limit(None)
        self.resume_writing()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Take a piece of the stream."""
        continued = self._in_head
        super().data_received(data)
        if continued and self._in_head:
            self._head_bytes += len(data)
            if self._head_bytes > MAX_HEADER_BYTES:
                self._refuse(_too_large())

    def on_message_begin(self) -> None:
        """Start the clock of a head."""
        super().on_message_begin()
        self._in_head, self._head_bytes = True, 0
        self._limit(self._settings.header_seconds)

    def on_headers_complete(self) -> None:
        """Pass the request on, unless its head is too large."""
        self._in_head = False
        self._limit(None)
        if len(self.url) + sum(len(name) + len(value) for name, value in self.headers) > MAX_HEADER_BYTES:
            self._refusal = _too_large()
            raise ValueError  # the parser stops, and uvicorn asks for send_400_response
        super().on_headers_complete()

    def on_message_complete(self) -> None:
        """Note the end of a body, perhaps after its answer."""
        super().on_message_complete()
        if self.cycle is not None and self.cycle.response_complete:
            self._limit(self.timeout_keep_alive)

    def on_response_complete(self) -> None:
        """Wait for the next request, or for the rest of a body that was not read."""
        super().on_response_complete()
        self._idle_since = self.loop.time()
        if self._idle and self.cycle.more_body:
            self._limit(self._settings.header_seconds)

    def send_400_response(self, msg: str) -> None:  # noqa: ARG002
        """Answer what is not HTTP, without the parser's words."""
        self._refuse(
            self._refusal or Problem("bad_request", "This is not an HTTP/1.1 request.", hint="See /docs for the API.")
        )

    def pause_writing(self) -> None:
        """Give the caller some time to take what was sent."""
        super().pause_writing()
        self._stalled = self.loop.call_later(self._settings.send_seconds, self.transport.abort)

    def resume_writing(self) -> None:
        """Go on: the caller takes it."""
        if self._stalled is not None:
            self._stalled.cancel()
        super().resume_writing()

    def _limit(self, seconds: float | None) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
        self._deadline = None if seconds is None else self.loop.call_later(seconds, self._late)

    def _late(self) -> None:
        if not self._idle:
            return  # the head of the next request, come before this one is answered
        if self._in_head:
            seconds = self._settings.header_seconds
            detail = f"The headers of the request did not arrive within {seconds:g} seconds."
            self._refuse(Problem("headers_too_slow", detail, hint="Send all headers at once."))
        else:
            self.transport.close()

    def _refuse(self, problem: Problem) -> None:
        if not self._idle and not self.cycle.more_body:
            self.cycle.keep_alive = False  # what was asked before is answered, then the connection ends
            return
        if not self.transport.is_closing() and (self._idle or not self.cycle.response_started):
            body = json.dumps(problem.body()).encode()
            headers = HEADERS | {
                "Content-Type": MEDIA_TYPE, "Content-Length": str(len(body)), "Connection": "close",
            }  # fmt: skip
            lines = [f"{name}: {value}\r\n".encode() for name, value in headers.items()]
            self.transport.write(b"".join([STATUS_LINE[problem.status], *lines, b"\r\n", body]))
        self.transport.close()


def _too_large() -> Problem:
    return Problem(
        "headers_too_large",
        f"The URL and the headers of the request are longer than {MAX_HEADER_BYTES} bytes together.",
        hint="Send shorter headers, and the parameters in the form.",
        limit=MAX_HEADER_BYTES,
    )
