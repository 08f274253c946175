"""A proxy before a service that can be told to misbehave."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import httpx

HOP = {"connection", "transfer-encoding", "host", "keep-alive", "date", "server"}


@dataclass
class Seen:
    """A request as it came to the proxy."""

    method: str
    path: str
    headers: dict[str, str]
    body: bytes


Fault = Callable[["Handler", Callable[[], httpx.Response]], None]
"""Misbehaves in place of an answer; the second argument asks the service."""


@dataclass
class Proxy:
    """Passes requests on, but lets each fault of ``faults`` answer one request first."""

    address: str = ""
    upstream: str = ""
    faults: list[Fault] = field(default_factory=list)
    seen: list[Seen] = field(default_factory=list)


class Handler(BaseHTTPRequestHandler):
    """One connection of the proxy."""

    protocol_version = "HTTP/1.1"
    proxy: Proxy

    def handle_any(self) -> None:
        body = self.rfile.read(int(self.headers.get("content-length", 0)))
        headers = {name.lower(): value for name, value in self.headers.items()}
        self.proxy.seen.append(Seen(self.command, self.path, headers, body))
        passed = {name: value for name, value in headers.items() if name not in HOP}

        def ask() -> httpx.Response:
            with httpx.Client(trust_env=False, timeout=60) as client:
                return client.request(self.command, self.proxy.upstream + self.path, headers=passed, content=body)

        if self.proxy.faults:
            self.proxy.faults.pop(0)(self, ask)
        else:
            response = ask()
            self.reply(response.status_code, dict(response.headers), response.content)

    do_GET = do_POST = do_DELETE = handle_any

    def reply(self, status: int, headers: dict[str, str], body: bytes = b"", *, cut: int | None = None) -> None:
        """Answer; with ``cut``, break off after so many bytes."""
        self.send_response(status)
        for name, value in headers.items():
            if name.lower() not in HOP | {"content-length", "content-encoding"}:  # the body is decoded
                self.send_header(name, value)
        if status != 304:
            self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body[:cut])
        if cut is not None:
            self.hang_up()

    def hang_up(self) -> None:
        """Close the connection without another word."""
        self.wfile.flush()
        self.close_connection = True

    def log_message(self, format: str, *args: object) -> None:
        """Keep the test's output clean."""


def busy(status: int, retry_after: str) -> Fault:
    """A refusal in the service's shape."""
    problem = f'{{"detail": "Busy.", "code": "too_busy", "status": {status}}}'.encode()
    headers = {"Retry-After": retry_after, "Content-Type": "application/problem+json"}
    return lambda handler, _ask: handler.reply(status, headers, problem)


def drop(handler: Handler, _ask: Callable[[], httpx.Response]) -> None:
    """The connection ends; the service never hears of the request."""
    handler.hang_up()


def drop_answer(handler: Handler, ask: Callable[[], httpx.Response]) -> None:
    """The service does what was asked, and its answer is lost."""
    ask()
    handler.hang_up()


def cut_answer(handler: Handler, ask: Callable[[], httpx.Response]) -> None:
    """Half an answer."""
    response = ask()
    handler.reply(response.status_code, dict(response.headers), response.content, cut=len(response.content) // 2)


def alter(handler: Handler, ask: Callable[[], httpx.Response]) -> None:
    """One byte of the body is another."""
    response = ask()
    changed = response.content[:-1] + bytes([response.content[-1] ^ 1])
    handler.reply(response.status_code, dict(response.headers), changed)


@contextmanager
def misbehaving(upstream: str) -> Iterator[Proxy]:
    """A proxy before the service at ``upstream``."""
    proxy = Proxy(upstream=upstream)
    handler = type("ProxyHandler", (Handler,), {"proxy": proxy})
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        server.daemon_threads = True
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        proxy.address = f"http://127.0.0.1:{server.server_port}"
        yield proxy
        server.shutdown()
        thread.join()
