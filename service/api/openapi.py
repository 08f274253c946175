"""The parts of the OpenAPI document that FastAPI cannot derive, each written once."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI

from ..problems import Problem
from .error_handlers import MEDIA_TYPE
from .intake.idempotency import HEADER, LONGEST_KEY
from .intake.parameters import Parameters
from .intake.upload import FILE_NAME, RAW_TYPES
from .results.download import MEDIA_TYPES
from .schemas import BatchView, JobView

Responses = dict[int | str, dict[str, Any]]

OCTETS = "application/octet-stream"
_BINARY = {"schema": {"type": "string", "format": "binary"}}


# The codes of problems: of every route, of those that ask for a key, that name a job, that give out its files.
EVERYWHERE = (
    "headers_too_slow",
    "headers_too_large",
    "cross_site",
    "internal_error",
    "too_busy",
    "database_unavailable",
    "database_corrupt",
    "data_read_only",
)
CALLER = ("not_authenticated", "too_many_requests")
JOB = (*CALLER, "invalid_parameters", "job_not_found", "job_expired")
BATCH = (*CALLER, "invalid_parameters", "batch_not_found")
FILES = (*JOB, "job_not_finished", "job_failed", "job_cancelled", "storage_unavailable")


def errors(*codes: str) -> Responses:
    """Return the OpenAPI responses of these problems and of those of every route, all of one shape, with examples."""
    found: Responses = {}
    for code in (*EVERYWHERE, *codes):
        problem = Problem(code, "What happened.", hint="What the caller can do about it.")
        media: dict[str, Any] = {"schema": {"$ref": "#/components/schemas/ProblemDetail"}, "examples": {}}
        response = {"description": HTTPStatus(problem.status).phrase, "content": {MEDIA_TYPE: media}}
        examples = found.setdefault(problem.status, response)["content"][MEDIA_TYPE]["examples"]
        examples[code] = {"value": problem.body("/path/of/the/request")}
    return found


def _fields() -> dict[str, Any]:
    properties: dict[str, Any] = Parameters.model_json_schema()["properties"]
    return properties


DENOISE_PARAMETERS = [
    {"name": name, "in": "query", "required": False, "description": schema["description"], "schema": schema}
    for name, schema in _fields().items()
] + [
    {
        "name": FILE_NAME,
        "in": "query",
        "required": False,
        "description": "Name of the file if it is the whole body; its extension tells text formats apart",
        "schema": {"type": "string"},
    },
    {
        "name": HEADER,
        "in": "header",
        "required": False,
        "description": "A value of the caller's choice, such as a UUID. A repeated request with the same key returns "
        "the same job",
        "schema": {"type": "string", "minLength": 1, "maxLength": LONGEST_KEY},
    },
    {
        "name": "Prefer",
        "in": "header",
        "required": False,
        "description": "`wait=N`: answer with the finished job if it takes no more than N seconds (RFC 7240)",
        "schema": {"type": "string"},
        "example": "wait=10",
    },
]
DENOISE_BODY = {
    "required": True,
    "content": {
        "multipart/form-data": {
            "schema": {
                "type": "object",
                "required": ["file"],
                "properties": {"file": {"type": "string", "format": "binary"}},
            }
        },
    }
    | dict.fromkeys(RAW_TYPES, _BINARY),
}
_LOCATION = {"Location": {"description": "Where the job is", "schema": {"type": "string"}}}
_APPLIED = {"Preference-Applied": {"description": "The seconds in force of `wait`", "schema": {"type": "string"}}}
DENOISED: Responses = errors(
    *CALLER,
    "bad_request",
    "upload_too_slow",
    "idempotency_key_in_use",
    "job_expired",
    "upload_too_large",
    "file_too_large",
    "too_many_points",
    "too_much_work",
    "unsupported_media_type",
    "unsupported_encoding",
    "unknown_format",
    "missing_extra",
    "invalid_parameters",
    "invalid_upload",
    "idempotency_key_reused",
    "empty_upload",
    "normals_missing",
    "not_enough_memory",
    "took_too_long",
    "quota_exceeded",
    "queue_full",
    "disk_full",
    "draining",
    "stopping",
    "storage_unavailable",
) | {
    200: {"model": JobView, "description": "The job finished while the caller waited", "headers": _LOCATION | _APPLIED},
    201: {"model": BatchView, "description": "Several files became a batch of jobs", "headers": _LOCATION},
    202: {"model": JobView, "description": "The job is queued", "headers": _LOCATION | _APPLIED},
}
LISTED: Responses = {
    200: {
        "description": "A page of jobs",
        "headers": {
            "Link": {"description": "The next page, as `rel=next`, if there is one", "schema": {"type": "string"}},
            "X-Total-Count": {"description": "Jobs on all pages", "schema": {"type": "integer"}},
        },
    },
}
ARCHIVE: Responses = {200: {"description": "A zip archive", "content": {"application/zip": _BINARY}}}
NOT_MODIFIED: Responses = {304: {"description": "Not changed since the ETag in If-None-Match"}}
_CONVERTED = ("not_enough_memory", "took_too_long", "disk_full")
RESULT_RESPONSES: Responses = (
    NOT_MODIFIED
    | errors(*FILES, "not_acceptable", "range_not_satisfiable", *_CONVERTED)
    | {
        200: {"description": "The cloud", "content": dict.fromkeys((OCTETS, *MEDIA_TYPES.values()), _BINARY)},
        206: {"description": "One range of it", "content": {OCTETS: _BINARY}},
    }
)
EVENTS: Responses = {
    200: {
        "description": "Events named `job`, whose data is the job as GET /jobs/{id} shows it, in JSON",
        "content": {"text/event-stream": {"schema": {"type": "string"}}},
    },
    204: {"description": "The job has finished, and Last-Event-ID is its last event"},
}
METRICS: Responses = {
    200: {
        "description": "For Prometheus, in its text format",
        "content": {"text/plain": {"schema": {"type": "string"}}},
    },
}
DISPLAY_RESPONSES: Responses = (
    NOT_MODIFIED
    | errors(*FILES, "display_not_found")
    | {
        200: {"description": "Binary glTF", "content": dict.fromkeys((OCTETS, "model/gltf-binary"), _BINARY)},
    }
)
CANCELLED: Responses = {
    200: {"model": JobView, "description": "The job is cancelled"},
    202: {"model": JobView, "description": "The worker was asked to stop"},
}
DELETED: Responses = {
    202: {"model": JobView, "description": "The worker was asked to stop"},
    204: {"description": "The finished job was removed"},
}


def install(app: FastAPI) -> None:
    """Let `app` describe itself by a document that says each thing once."""
    by_framework = app.openapi

    def document() -> dict[str, Any]:
        if app.openapi_schema is None:
            app.openapi_schema = _shared(by_framework())
        return app.openapi_schema

    app.openapi = document  # type: ignore[method-assign]


def _shared(document: dict[str, Any]) -> dict[str, Any]:
    """Return the document with examples, and responses that several routes have, moved to its components."""
    components = document["components"]
    examples = components.setdefault("examples", {})
    errors_ = [(responses, status) for responses in _responses(document) for status in responses if status >= "400"]
    for responses, status in errors_:
        media = responses[status]["content"][MEDIA_TYPE]
        examples |= media["examples"]
        media["examples"] = {code: {"$ref": f"#/components/examples/{code}"} for code in media["examples"]}
    written = Counter(json.dumps(responses[status]) for responses, status in errors_)
    names: dict[str, str] = {}
    for responses, status in errors_:
        text = json.dumps(responses[status])
        if written[text] > 1:
            name = names.setdefault(text, f"Problem{status}_{len(names)}")
            components.setdefault("responses", {})[name] = json.loads(text)
            responses[status] = {"$ref": f"#/components/responses/{name}"}
    return document


def _responses(document: dict[str, Any]) -> Iterator[dict[str, Any]]:
    for operations in document["paths"].values():
        for operation in operations.values():
            yield operation["responses"]
