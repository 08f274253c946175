from __future__ import annotations

import json
import subprocess
import sys
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest
from opentelemetry.proto.trace.v1.trace_pb2 import Span

from service.telemetry import tracing
from tests.support.service_process import Service

TRACE = "0af7651916cd43dd8448eb211c80319c"
PARENT = "b7ad6b7169203331"


class Receiver(ThreadingHTTPServer):
    """What takes spans by OTLP over HTTP."""

    def __init__(self) -> None:
        self.spans: list[tuple[str, Span]] = []  # each with the name of its service
        spans = self.spans

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["Content-Length"]))
                for part in ExportTraceServiceRequest.FromString(body).resource_spans:
                    names = {item.key: item.value.string_value for item in part.resource.attributes}
                    spans.extend((names["service.name"], span) for scope in part.scope_spans for span in scope.spans)
                self.send_response(200)
                self.end_headers()

            def log_message(self, *_: object) -> None:
                pass

        super().__init__(("127.0.0.1", 0), Handler)


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    with Receiver() as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def test_one_trace_from_the_request_to_the_result(receiver: Receiver, tmp_path: Path, small: Path) -> None:
    service = Service(tmp_path, log_format="json")
    service.environment["OTEL_EXPORTER_OTLP_ENDPOINT"] = f"http://127.0.0.1:{receiver.server_port}"
    service.start()
    headers = {"traceparent": f"00-{TRACE}-{PARENT}-01", "X-Request-ID": "r1"}
    upload = {"file": ("private.ply", small.read_bytes())}
    job = service.client.post("/denoise?iterations=1", files=upload, headers=headers).json()
    service.wait_status(job["id"], "succeeded")
    assert service.stop() == 0, service.output()
    spans = [(name, span) for name, span in receiver.spans if span.trace_id.hex() == TRACE]
    assert {(name, span.name) for name, span in spans if not span.name.startswith("fastapi.")} == {
        ("pcdnf-api", name) for name in ("POST /denoise", "upload", "check", "store", "queue")
    } | {("pcdnf-worker", name) for name in ("job", "survey", "prepare", "tile", "merge", "result")}
    by_name = {span.name: span for _, span in spans}
    request, work = by_name["POST /denoise"], by_name["job"]
    assert request.parent_span_id.hex() == PARENT
    assert request.kind == Span.SPAN_KIND_SERVER
    assert work.parent_span_id == by_name["queue"].span_id
    assert by_name["tile"].parent_span_id == work.span_id
    assert by_name["tile"].end_time_unix_nano > by_name["tile"].start_time_unix_nano
    assert not any("private" in str(span) for _, span in spans)
    lines = [json.loads(line) for line in service.output().splitlines() if line.startswith("{")]
    told = [line for line in lines if line.get("job_id") == job["id"] and line["logger"] == "service.worker.workflow"]
    assert told
    assert {(line["request_id"], line["trace_id"]) for line in told} == {("r1", TRACE)}


def test_a_collector_that_is_away_holds_up_no_stop(tmp_path: Path) -> None:
    code = (
        "import time; from service.telemetry import tracing; tracing.configure('x')\n"
        "with tracing.span('lost'): pass\n"
        "began = time.monotonic(); tracing.close(); print(time.monotonic() - began)"
    )
    environment = {"OTEL_EXPORTER_OTLP_ENDPOINT": "http://127.0.0.1:1", "HOME": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, timeout=60)
    assert done.returncode == 0, done.stderr
    assert 0 < float(done.stdout) < tracing.FLUSH_SECONDS + 1


def test_without_an_endpoint_nothing_is_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in tracing.ENDPOINTS:
        monkeypatch.delenv(name, raising=False)
    tracing.configure("pcdnf-test")
    with tracing.span("x", carrier={"traceparent": f"00-{TRACE}-{PARENT}-01"}) as span:
        assert not span.is_recording()
        assert tracing.carried() == {"traceparent": f"00-{TRACE}-{PARENT}-01"}
    assert tracing.carried() == {}


def test_without_the_extra_it_says_what_to_install() -> None:
    code = (
        "import sys; sys.modules['opentelemetry.sdk.trace'] = None\n"
        "from service.telemetry import tracing; tracing.configure('x')"
    )
    environment = {"OTEL_EXPORTER_OTLP_ENDPOINT": "http://127.0.0.1:1"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment)
    assert "TracesMissingError" in done.stderr
    assert "pip install 'pcdnf[traces]'" in done.stderr
