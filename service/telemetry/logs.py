"""The log on standard error, as lines of text or of JSON.

Every line carries the ids of its request, its job and its trace. File names and keys are never logged.
"""

from __future__ import annotations

import json
import logging
import secrets
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from datetime import UTC, datetime
from typing import Any

from opentelemetry import trace

TEXT = "%(asctime)s %(levelname)s %(process)d %(name)s: %(message)s"
ATTRIBUTES = "attributes"  # the key of `extra` for further members of a line of JSON

_ids: ContextVar[dict[str, str]] = ContextVar("ids", default={})  # noqa: B039  (never changed, only replaced)


@contextmanager
def about(**ids: str) -> Iterator[None]:
    """Add these ids to every line that this thread or task logs inside."""
    token = _ids.set(_ids.get() | ids)
    try:
        yield
    finally:
        _ids.reset(token)


def ids() -> dict[str, str]:
    """Return the ids of the lines logged here, as far as known: `request_id`, `job_id`, `trace_id`, `span_id`."""
    span = trace.get_current_span().get_span_context()
    if not span.is_valid:
        return _ids.get()
    return _ids.get() | {
        "trace_id": trace.format_trace_id(span.trace_id),
        "span_id": trace.format_span_id(span.span_id),
    }


def fresh_id() -> str:
    """Return an id for a request that came without one: 64 random bits in hex."""
    return secrets.token_hex(8)


class TextFormatter(logging.Formatter):
    """A line of text, with the ids behind it."""

    def __init__(self) -> None:
        super().__init__(TEXT)

    def formatMessage(self, record: logging.LogRecord) -> str:
        """Return the line without its trace."""
        known = " ".join(f"{name}={value}" for name, value in ids().items() if name != "span_id")
        line = super().formatMessage(record)
        return f"{line} [{known}]" if known else line


class JsonFormatter(logging.Formatter):
    """A JSON object per line."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line."""
        line: dict[str, Any] = {
            "timestamp": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "process": record.process,
            "message": record.getMessage(),
        }
        line |= ids() | getattr(record, ATTRIBUTES, {})
        if record.exc_info:
            line["exception"] = self.formatException(record.exc_info)
        return json.dumps(line, ensure_ascii=False, default=str)


def configure(level: str, format_: str) -> None:
    """Log to standard error, Python's warnings included; of the engine only warnings.

    Parameters
    ----------
    level : str
        Least severe level shown: ``debug``, ``info``, ``warning`` or ``error``.
    format_ : str
        ``text`` or ``json``.
    """
    level = level.upper()
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonFormatter() if format_ == "json" else TextFormatter())
    logging.basicConfig(level=level, handlers=[handler], force=True)
    logging.captureWarnings(True)
    engine = logging.getLogger("dbos")
    engine.setLevel(level if level in ("DEBUG", "ERROR") else "WARNING")
    engine.handlers, engine.propagate = [handler], False  # it would add its own handler
    logging.getLogger("numba").setLevel("WARNING")
