"""Traces by OpenTelemetry: from the caller's ``traceparent`` through the request into the job and its stages.

Without the extra ``traces``, or without ``OTEL_EXPORTER_OTLP_ENDPOINT``, no span is exported. The caller's trace id is
logged in any case.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from opentelemetry import trace
from opentelemetry.context import Context
from opentelemetry.trace import Span, SpanKind
from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

from .logs import ids

ENDPOINTS = ("OTEL_EXPORTER_OTLP_ENDPOINT", "OTEL_EXPORTER_OTLP_TRACES_ENDPOINT")
FLUSH_SECONDS = 3.0

_propagator = TraceContextTextMapPropagator()


class TracesMissingError(Exception):
    """The environment asks for traces, but their libraries are not installed; the text says what to do."""


def is_enabled() -> bool:
    """Return whether the environment says where to send spans."""
    return any(os.environ.get(name) for name in ENDPOINTS)


def configure(service: str) -> None:
    """Export spans by OTLP over HTTP if the environment asks for it.

    Parameters
    ----------
    service : str
        Name of the service, unless OTEL_SERVICE_NAME gives one.

    Raises
    ------
    TracesMissingError
    """
    if not is_enabled():
        return
    try:
        from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
        from opentelemetry.sdk.resources import Resource
        from opentelemetry.sdk.trace import TracerProvider
        from opentelemetry.sdk.trace.export import BatchSpanProcessor
    except ImportError as error:
        raise TracesMissingError(
            f"{' or '.join(ENDPOINTS)} is set, but the libraries that send traces are not installed. "
            "Run: pip install 'pcdnf[traces]', or unset the variable."
        ) from error
    name = os.environ.get("OTEL_SERVICE_NAME", service)
    provider = TracerProvider(resource=Resource.create({"service.name": name}), shutdown_on_exit=False)  # see close
    provider.add_span_processor(BatchSpanProcessor(OTLPSpanExporter()))
    trace.set_tracer_provider(provider)


def close() -> None:
    """Export the last spans, for a few seconds at most, so that an unreachable collector does not delay the exit."""
    flush = getattr(trace.get_tracer_provider(), "force_flush", None)
    if flush is not None:
        thread = threading.Thread(target=flush, name="flush", daemon=True)
        thread.start()
        thread.join(FLUSH_SECONDS)


@contextmanager
def span(name: str, *, carrier: Mapping[str, str] | None = None, server: bool = False) -> Iterator[Span]:
    """Time what happens inside as a span, below the one in `carrier`'s ``traceparent`` or else the present one."""
    parent = None if carrier is None else _propagator.extract(carrier, context=Context())
    kind = SpanKind.SERVER if server else SpanKind.INTERNAL
    with trace.get_tracer("pcdnf").start_as_current_span(name, context=parent, kind=kind) as started:
        yield started


def carried() -> dict[str, str]:
    """Return the `request_id`, `traceparent` and `tracestate` of this request, for the job that it creates."""
    carrier = {name: value for name, value in ids().items() if name == "request_id"}
    _propagator.inject(carrier)
    return carrier
