"""Raw sockets: what no HTTP client would send."""

from __future__ import annotations

import json
import random
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import pytest

from service.api.app import create_app
from service.api.http_protocol import MAX_HEADER_BYTES
from service.settings import Settings
from tests.support.service_process import Served

GET = b"GET /livez HTTP/1.1\r\nHost: localhost\r\n"
POST = b"POST /denoise HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/ply\r\n"
MakeServed = Callable[..., Served]


@contextmanager
def connect(served: Served) -> Iterator[socket.socket]:
    with socket.create_connection(served.address, timeout=10) as connection:
        yield connection


def rest(connection: socket.socket) -> bytes:
    """Read until the service closes."""
    received = b""
    with suppress(ConnectionResetError):
        while piece := connection.recv(65536):
            received += piece
    return received


def answers(received: bytes) -> list[tuple[int, dict[str, str], Any]]:
    """Take answers with a Content-Length apart: status, headers, JSON."""
    found = []
    while received:
        head, _, received = received.partition(b"\r\n\r\n")
        status, *lines = head.decode().split("\r\n")
        headers = {name.lower(): value for name, value in (line.split(": ", 1) for line in lines)}
        size = int(headers["content-length"])
        found.append((int(status.split()[1]), headers, json.loads(received[:size])))
        received = received[size:]
    return found


def ask(served: Served, request: bytes) -> list[tuple[int, dict[str, str], Any]]:
    """Send bytes, and return the answers until there is one and nothing more comes, or the service closes."""
    with connect(served) as connection:
        connection.sendall(request)
        received = b""
        with suppress(TimeoutError, ConnectionResetError):
            while piece := connection.recv(65536):
                received += piece
                connection.settimeout(0.05)
        return answers(received)


def alive(served: Served) -> bool:
    return served.client.get("/livez").status_code == 200


def test_slow_headers(make_served: MakeServed) -> None:
    served = make_served(header_seconds=0.6)
    with connect(served) as connection:
        began = time.monotonic()
        received = b""
        connection.settimeout(0.1)
        for octet in GET + b"X-Slow: " + b"a" * 100:  # a byte now and then does not help
            connection.sendall(bytes([octet]))
            try:
                received = connection.recv(65536)
                break
            except TimeoutError:
                continue
        assert 0.5 < time.monotonic() - began < 5
    [(status, headers, body)] = answers(received)
    assert (status, body["code"], headers["connection"]) == (408, "headers_too_slow", "close")
    assert headers["content-type"] == "application/problem+json"
    assert headers["x-content-type-options"] == "nosniff"


def test_slow_headers_on_a_connection_in_use(make_served: MakeServed) -> None:
    served = make_served(header_seconds=0.6)
    with connect(served) as connection:
        connection.sendall(GET + b"\r\n")
        assert connection.recv(65536).startswith(b"HTTP/1.1 200")
        time.sleep(1)  # between two requests it may be silent for longer
        connection.sendall(GET)
        [(status, _, _)] = answers(rest(connection))
    assert status == 408


def test_a_connection_that_says_nothing_is_closed(make_served: MakeServed) -> None:
    served = make_served(header_seconds=0.5)
    with connect(served) as connection:
        began = time.monotonic()
        assert rest(connection) == b""
        assert 0.4 < time.monotonic() - began < 5


def test_a_body_that_goes_on_after_its_answer_is_cut(make_served: MakeServed) -> None:
    served = make_served(header_seconds=0.5)
    with connect(served) as connection:
        connection.sendall(b"DELETE /jobs/none HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100000000\r\n\r\n")
        assert connection.recv(65536).startswith(b"HTTP/1.1 404")
        began = time.monotonic()
        with suppress(OSError):
            while time.monotonic() - began < 8:
                connection.sendall(b"x")
                time.sleep(0.05)
        assert time.monotonic() - began < 5


def test_an_answer_that_nobody_takes_is_cut(make_served: MakeServed) -> None:
    served = make_served(send_seconds=0.5)
    with connect(served) as connection:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        for _ in range(3000):
            try:
                connection.sendall(b"GET /openapi.json HTTP/1.1\r\nHost: localhost\r\n\r\n")
            except OSError:
                break
            time.sleep(0.001)
        deadline = time.monotonic() + 8
        while served.server.server_state.connections and time.monotonic() < deadline:
            time.sleep(0.05)
        assert not served.server.server_state.connections
    assert alive(served)


@pytest.mark.parametrize("pieces", [1, 40])
def test_headers_that_are_too_long(make_served: MakeServed, pieces: int) -> None:
    served = make_served()
    request = GET + b"".join(b"X-%d: %b\r\n" % (i, b"a" * 1000) for i in range(MAX_HEADER_BYTES // 1000 + 1)) + b"\r\n"
    with connect(served) as connection:
        for at in range(0, len(request), len(request) // pieces + 1):
            connection.sendall(request[at : at + len(request) // pieces + 1])
            time.sleep(0.002)
        [(status, _, body)] = answers(rest(connection))
    assert (status, body["code"], body["limit"]) == (431, "headers_too_large", MAX_HEADER_BYTES)
    assert alive(served)


def test_a_header_without_end_takes_no_memory(make_served: MakeServed) -> None:
    served = make_served()
    with connect(served) as connection:
        sent = 0
        with suppress(OSError):
            while sent < 50_000_000:
                connection.sendall((GET + b"X: " if not sent else b"") + b"a" * 10_000)
                sent += 10_000
                time.sleep(0.001)
    assert sent < 10_000_000


@pytest.mark.parametrize(
    ("request_", "status"),
    [
        (b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + bytes(range(200)), 400),  # TLS
        (b"\x00" * 500, 400),
        (b"GET / HTTP/9.9\r\n\r\n", 400),
        (b"GET /livez\r\n\r\n", 403),  # HTTP 0.9
        (b"GET /\xff\xfe HTTP/1.1\r\nHost: localhost\r\n\r\n", 400),
        (b"GET /a\x00b HTTP/1.1\r\nHost: localhost\r\n\r\n", 400),
        (GET + b"X: a\x00b\r\n\r\n", 400),
        (GET + b"X : a\r\n\r\n", 400),
        (GET + b"no colon\r\n\r\n", 400),
        (b"CONNECT example.org:443 HTTP/1.1\r\nHost: example.org\r\n\r\n", 400),
        (POST + b"Content-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n", 400),
        (POST + b"Content-Length: 5\r\nContent-Length: 6\r\n\r\nabcdef", 400),
        (POST + b"Content-Length: -1\r\n\r\n", 400),
        (POST + b"Content-Length: 99999999999999999999999\r\n\r\n", 400),
        (POST + b"Transfer-Encoding: chunked\r\n\r\nzz\r\nabc\r\n", 400),
        (POST + b"Transfer-Encoding: chunked\r\n\r\n-5\r\nabc\r\n", 400),
        (POST + b"Transfer-Encoding: chunked\r\n\r\nFFFFFFFFFFFFFFFFFF\r\nabc\r\n", 400),
        (POST + b"Transfer-Encoding: chunked\r\n\r\n3\r\nabcdef\r\n", 400),
        (POST + b"Transfer-Encoding: gzip, chunked\r\n\r\n0\r\n\r\n", 422),
        (b"GET http://127.0.0.1/livez HTTP/1.1\r\nHost: localhost\r\n\r\n", 200),
        (b"GET /%00 HTTP/1.1\r\nHost: localhost\r\n\r\n", 404),
        (b"GET /jobs/%00 HTTP/1.1\r\nHost: localhost\r\n\r\n", 404),
        (b"GET /jobs/%ff%fe HTTP/1.1\r\nHost: localhost\r\n\r\n", 404),
        (b"GET /jobs/" + b"a" * 20_000 + b" HTTP/1.1\r\nHost: localhost\r\n\r\n", 404),
        (b"GET //evil.example/livez HTTP/1.1\r\nHost: localhost\r\n\r\n", 404),
        (b"GET /livez HTTP/1.1\r\n\r\n", 403),  # no Host
        (b"BREW /livez HTTP/1.1\r\nHost: localhost\r\n\r\n", 400),
        (b"PATCH /livez HTTP/1.1\r\nHost: localhost\r\n\r\n", 405),
        (GET + b"Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Key: x\r\n\r\n", 200),
        (GET + b"Upgrade: h2c\r\nConnection: Upgrade\r\n\r\n", 200),
    ],
)  # fmt: skip
def test_odd_requests(api_served: Served, request_: bytes, status: int) -> None:
    [(found, headers, body)] = ask(api_served, request_)
    assert found == status, body
    assert headers["x-content-type-options"] == "nosniff"
    if status >= 400:
        assert headers["content-type"] == "application/problem+json"
        assert body["code"]
        assert not any(word in json.dumps(body).lower() for word in ("traceback", "httptools", "uvicorn", "starlette"))
    assert alive(api_served)


@pytest.fixture(scope="module")
def api_served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    served = Served(create_app(Settings(data_dir=tmp_path_factory.mktemp("raw"))))
    with served:
        yield served


def test_pipelined_requests_are_answered_in_order(api_served: Served) -> None:
    paths = [b"/livez", b"/jobs", b"/nothing", b"/livez"]
    requests = [b"GET %b HTTP/1.1\r\nHost: localhost\r\n\r\n" % path for path in paths]
    with connect(api_served) as connection:
        connection.sendall(b"".join(requests) + b"nonsense\r\n\r\n")
        found = answers(rest(connection))
    assert [status for status, _, _ in found] == [200, 200, 404, 200]
    assert alive(api_served)


def test_a_flood_of_small_chunks_is_one_upload(api_served: Served) -> None:
    body = b"".join(b"1\r\n%b\r\n" % bytes([octet]) for octet in b"ply\n" * 5000) + b"0\r\n\r\n"
    [(status, _, answer)] = ask(api_served, POST + b"Transfer-Encoding: chunked\r\n\r\n" + body)
    assert (status, answer["code"]) == (422, "bad_header")


def test_random_bytes(api_served: Served) -> None:
    random_ = random.Random(0)
    valid = GET + b"Accept: */*\r\n\r\n"
    for _ in range(200):
        octets = bytearray(valid if random_.random() < 0.7 else random_.randbytes(100))
        for _ in range(random_.randrange(4)):
            octets[random_.randrange(len(octets))] = random_.randrange(256)
        with connect(api_served) as connection:
            connection.sendall(octets + b"\r\n\r\n")
            connection.shutdown(socket.SHUT_WR)
            assert all(status < 500 for status, _, _ in answers(rest(connection)))
    assert alive(api_served)


def test_many_connections_push_out_the_idle_ones(make_served: MakeServed) -> None:
    served = make_served(max_connections=5)
    with connect(served) as first:
        first.sendall(GET)
        time.sleep(0.1)
        others = [socket.create_connection(served.address, timeout=5) for _ in range(5)]
        assert rest(first) == b""
        assert alive(served)
        for other in others:
            other.close()
