"""The delivery of callbacks, by a real receiver: signed, pinned to the checked address, without redirects."""

from __future__ import annotations

import ipaddress
import json
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
import pytest

from service.jobs.callback import CallbackError, signature
from service.settings import Settings
from service.worker.callbacks import deliver, is_public, message, send
from tests.support.board import Board
from tests.support.service_process import Service

SECRET = "a secret of the tests, of more than 32"


class Receiver(HTTPServer):
    """Keeps what it is sent, and answers with a status."""

    def __init__(self) -> None:
        self.seen: list[tuple[str, dict[str, str], bytes]] = []
        self.answer = 204
        super().__init__(("127.0.0.1", 0), _Handler)


class _Handler(BaseHTTPRequestHandler):
    def do_POST(self) -> None:
        receiver = self.server
        assert isinstance(receiver, Receiver)
        body = self.rfile.read(int(self.headers["content-length"]))
        receiver.seen.append((self.path, {name.lower(): value for name, value in self.headers.items()}, body))
        self.send_response(receiver.answer)
        self.send_header("Location", "/elsewhere")
        self.send_header("Content-Length", "0")
        self.end_headers()

    def log_message(self, *_: Any) -> None:
        pass


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    server = Receiver()
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    yield server
    server.shutdown()
    thread.join()
    server.server_close()


def post(receiver: Receiver, body: bytes = b"{}", host: str = "localhost") -> int:
    target = urlsplit(f"http://{host}:{receiver.server_port}/done?job=1")
    return send(target, body, "a-job", SECRET, is_allowed=lambda address: address.is_loopback)


def test_a_message_is_signed_and_names_the_host(receiver: Receiver) -> None:
    assert post(receiver, b'{"a": 1}') == 204
    ((path, headers, body),) = receiver.seen
    assert (path, body) == ("/done?job=1", b'{"a": 1}')
    assert headers["host"] == f"localhost:{receiver.server_port}"
    stamp = int(headers["webhook-timestamp"])
    assert abs(stamp - time.time()) < 60
    assert headers["webhook-signature"] == signature(SECRET, "a-job", stamp, body)
    assert headers["webhook-id"] == "a-job"
    assert SECRET not in str(headers)


def test_redirects_are_not_followed(receiver: Receiver) -> None:
    receiver.answer = 307
    assert post(receiver) == 307
    assert [path for path, _, _ in receiver.seen] == ["/done?job=1"]


def test_nothing_is_sent_to_an_address_that_is_not_public(receiver: Receiver) -> None:
    for host in ("localhost", "127.0.0.1"):
        with pytest.raises(CallbackError, match="not public"):
            send(urlsplit(f"http://{host}:{receiver.server_port}/"), b"", "a", SECRET)
    assert receiver.seen == []


@pytest.mark.parametrize(
    "address",
    [
        "127.0.0.1", "10.0.0.1", "172.16.0.1", "192.168.1.1", "169.254.169.254", "100.64.0.1", "0.0.0.0",
        "224.0.0.1", "255.255.255.255", "::1", "::", "fe80::1", "fc00::1", "ff02::1", "::ffff:10.0.0.1",
        "::ffff:93.184.216.34", "2002:a00:1::", "64:ff9b::a00:1",
    ],
)  # fmt: skip
def test_addresses_inside(address: str) -> None:
    assert not is_public(ipaddress.ip_address(address))


@pytest.mark.parametrize("address", ["93.184.216.34", "2606:2800:220:1:248:1893:25c8:1946"])
def test_addresses_outside(address: str) -> None:
    assert is_public(ipaddress.ip_address(address))


def test_a_message_says_what_ended_and_nothing_of_the_cloud(board: Board) -> None:
    job = board.submit(name="a private name")
    board.set(job.id, status="succeeded", finished_at=1_700_000_000_000)
    found = json.loads(message(board.now(job)))
    assert found == {
        "type": "job.succeeded",
        "timestamp": "2023-11-14T22:13:20+00:00",
        "data": {
            "id": job.id,
            "status": "succeeded",
            "problem": None,
            "links": {"self": f"/jobs/{job.id}", "result": f"/jobs/{job.id}/result"},
        },
    }


def test_a_host_that_is_no_longer_allowed_gets_nothing(board: Board, tmp_path: Path) -> None:
    job = board.submit()
    board.set(job.id, parameters={"callback_url": "https://hooks.example.org/"}, status="failed")
    assert deliver(board.now(job), Settings(data_dir=tmp_path)) == "given_up"


@pytest.mark.parametrize(("answer", "error"), [(None, httpx.ConnectError), (204, None)])
def test_a_receiver_that_is_away(receiver: Receiver, answer: int | None, error: type[Exception] | None) -> None:
    if error is None:
        assert post(receiver) == answer
        return
    target = urlsplit("http://127.0.0.1:1/")
    with pytest.raises(error):
        send(target, b"", "a", SECRET, is_allowed=lambda address: address.is_loopback)


@pytest.mark.full
def test_a_failed_delivery_is_tried_again_by_the_engine(tmp_path: Path, small: Path) -> None:
    service = Service(tmp_path, callback_hosts="nowhere.invalid", callback_secret=SECRET).start()
    job = service.submit(small, callback_url="https://nowhere.invalid/Done")
    assert job["parameters"]["callback_url"] == "https://nowhere.invalid/Done"
    assert job["callback"] == "due"
    service.wait_status(job["id"], "succeeded")
    deadline = time.monotonic() + 60
    while service.output().count("was not taken") < 2:
        assert time.monotonic() < deadline, service.output()
        time.sleep(0.2)
    assert service.job(job["id"])["callback"] == "queued"
    assert service.stop() == 0, service.output()
