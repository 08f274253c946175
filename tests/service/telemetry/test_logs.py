from __future__ import annotations

import io
import json
import logging
import subprocess
import sys
from collections.abc import Iterator

import pytest

from service.telemetry import logs
from service.telemetry.tracing import span

TRACE = "0af7651916cd43dd8448eb211c80319c"
PARENT = {"traceparent": f"00-{TRACE}-b7ad6b7169203331-01"}


@pytest.fixture
def lines() -> Iterator[io.StringIO]:
    handler = logging.StreamHandler(io.StringIO())
    handler.setFormatter(logs.JsonFormatter())
    log = logging.getLogger("service.tested")
    log.addHandler(handler)
    log.setLevel("INFO")
    log.propagate = False
    yield handler.stream
    log.removeHandler(handler)


def test_lines_of_json_are_about_something(lines: io.StringIO) -> None:
    log = logging.getLogger("service.tested")
    log.info("before")
    with logs.about(request_id="r"), logs.about(job_id="j"), span("x", carrier=PARENT):
        log.info("a %s\nb", "ü", extra={logs.ATTRIBUTES: {"http.route": "/jobs"}})
    log.info("after")
    before, inside, after = map(json.loads, lines.getvalue().splitlines())
    assert set(before) == set(after) == {"timestamp", "level", "logger", "process", "message"}
    assert (
        inside.items()
        >= {
            "level": "info",
            "logger": "service.tested",
            "message": "a ü\nb",
            "request_id": "r",
            "job_id": "j",
            "trace_id": TRACE,
            "http.route": "/jobs",
        }.items()
    )
    assert before["timestamp"].endswith("+00:00")


def test_a_trace_of_an_error_is_one_line(lines: io.StringIO) -> None:
    try:
        raise ZeroDivisionError("by nothing")
    except ZeroDivisionError:
        logging.getLogger("service.tested").exception("it failed")
    [line] = map(json.loads, lines.getvalue().splitlines())
    assert line["level"] == "error"
    assert line["exception"].startswith("Traceback")
    assert line["exception"].endswith("ZeroDivisionError: by nothing")


def test_text_has_the_ids_behind_the_message() -> None:
    record = logging.LogRecord("service.x", logging.INFO, __file__, 1, "done", None, None)
    formatter = logs.TextFormatter()
    assert formatter.format(record).endswith(" service.x: done")
    with logs.about(request_id="r", job_id="j"):
        assert formatter.format(record).endswith(" service.x: done [request_id=r job_id=j]")


def test_every_library_logs_the_same_way() -> None:
    code = (
        "import logging, warnings; from dbos._logger import init_logger; "
        "from service.telemetry import logs; logs.configure('info', 'json'); init_logger();"
        "logging.getLogger('dbos').warning('engine'); warnings.warn('careful'); logging.getLogger('uvicorn').error('u')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    found = [json.loads(line) for line in done.stderr.splitlines()]
    assert [line["logger"] for line in found] == ["dbos", "py.warnings", "uvicorn"]
    assert done.stdout == ""
