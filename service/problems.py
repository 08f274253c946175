"""One error shape for every route and for the framework's own errors: RFC 9457 ``application/problem+json``."""

from __future__ import annotations

import errno
import logging
import sqlite3
from collections.abc import Mapping
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel, ConfigDict, Field
from sqlalchemy.exc import SQLAlchemyError
from starlette.exceptions import HTTPException
from starlette.routing import Match, Route

from .storage import StorageError

log = logging.getLogger(__name__)

MEDIA_TYPE = "application/problem+json"

# code -> (status, title). The codes are stable; programs compare them, not the text.
CATALOGUE: dict[str, tuple[int, str]] = {
    "bad_request": (400, "Bad request"),
    "not_authenticated": (401, "A key is needed"),
    "cross_site": (403, "Not from another site"),
    "not_found": (404, "No such page"),
    "job_not_found": (404, "No such job"),
    "display_not_found": (404, "Nothing to draw"),
    "model_not_found": (404, "No such model"),
    "method_not_allowed": (405, "Method not allowed"),
    "not_acceptable": (406, "No result in that format"),
    "headers_too_slow": (408, "The headers took too long"),
    "upload_too_slow": (408, "The upload took too long"),
    "job_not_finished": (409, "The job has not finished"),
    "idempotency_key_in_use": (409, "The idempotency key is in use"),
    "job_failed": (409, "The job failed"),
    "job_cancelled": (410, "The job was cancelled"),
    "job_expired": (410, "The job has expired"),
    "upload_too_large": (413, "The upload is too large"),
    "file_too_large": (413, "The file is too large"),
    "too_many_points": (413, "The cloud has too many points"),
    "too_much_work": (413, "The job is too large"),
    "unsupported_media_type": (415, "The upload is not of a supported type"),
    "unsupported_encoding": (415, "The upload is compressed"),
    "unknown_format": (415, "The file is of no known format"),
    "missing_extra": (415, "The service was installed without this format"),
    "range_not_satisfiable": (416, "No such range"),
    "invalid_parameters": (422, "Invalid parameters"),
    "invalid_upload": (422, "Invalid upload"),
    "idempotency_key_reused": (422, "The idempotency key was used for another request"),
    "empty_upload": (422, "The upload is empty"),
    "normals_missing": (422, "The cloud has no normals"),
    "not_enough_memory": (422, "The file needs too much memory to read"),
    "took_too_long": (422, "The file takes too long to read"),
    "headers_too_large": (431, "The headers are too long"),
    "too_many_requests": (429, "Too many requests"),
    "quota_exceeded": (429, "Too many unfinished jobs"),
    "internal_error": (500, "Internal error"),
    "queue_full": (503, "The queue is full"),
    "disk_full": (503, "Not enough disk space"),
    "too_busy": (503, "Too many requests at the same time"),
    "not_ready": (503, "Not ready"),
    "draining": (503, "No new jobs for now"),
    "stopping": (503, "The service is stopping"),
    "database_unavailable": (503, "The job database cannot be reached"),
    "storage_unavailable": (503, "The storage cannot be reached"),
    # How a job may fail; shown in the job's `problem`.
    "worker_lost": (500, "The worker died on this job"),
    "model_changed": (500, "The model changed while the job was under way"),
    "workers_differ": (500, "The workers do not compute alike"),
    "out_of_memory": (500, "Not enough memory"),
}
# For errors of the framework itself.
_BY_STATUS = {
    401: "not_authenticated",
    404: "not_found",
    405: "method_not_allowed",
    413: "upload_too_large",
    415: "unsupported_media_type",
    422: "invalid_parameters",
    429: "too_many_requests",
    503: "too_busy",
}


class ProblemDetail(BaseModel):
    """An error, in the shape of RFC 9457."""

    model_config = ConfigDict(extra="allow")

    type: str = Field(description="`urn:pcdnf:problem:` and the code")
    title: str = Field(description="What this code means")
    status: int = Field(description="The HTTP status")
    detail: str = Field(description="What happened, in a sentence")
    instance: str | None = Field(None, description="The path of the request, or of the job")
    code: str = Field(description="Stable identifier for programs")
    hint: str | None = Field(None, description="What to do about it")
    limit: int | float | None = Field(None, description="The limit that was passed")
    actual: int | float | None = Field(None, description="The value that passed it")


class Problem(Exception):
    """An error to answer with.

    Parameters
    ----------
    code : str
        A key of :data:`CATALOGUE`, or with `status` and `title` given, any stable snake-case name.
    detail : str
        What happened, in our own words.
    hint : str, optional
        What to do about it.
    headers : mapping, optional
        Further response headers.
    status, title : optional
        In place of the catalogue's.
    **members
        Further members of the problem object (``limit``, ``actual``, ``errors``, ...); None is left out.
    """

    def __init__(
        self,
        code: str,
        detail: str,
        *,
        hint: str | None = None,
        headers: Mapping[str, str] | None = None,
        status: int | None = None,
        title: str | None = None,
        **members: Any,
    ) -> None:
        super().__init__(detail)
        known_status, known_title = CATALOGUE.get(code, (500, code.replace("_", " ").capitalize()))
        self.code = code
        self.detail = detail
        self.status = known_status if status is None else status
        self.title = known_title if title is None else title
        self.headers = dict(headers or {})
        self.members = {"hint": hint} | members

    def body(self, instance: str | None = None) -> dict[str, Any]:
        """Return the JSON object."""
        members = {"instance": instance, "code": self.code} | self.members
        return {
            "type": f"urn:pcdnf:problem:{self.code}",
            "title": self.title,
            "status": self.status,
            "detail": self.detail,
        } | {name: value for name, value in members.items() if value is not None}

    def response(self, request: Request) -> JSONResponse:
        """Return the HTTP response."""
        return JSONResponse(
            self.body(request.url.path), status_code=self.status, headers=self.headers, media_type=MEDIA_TYPE
        )


def _from_framework(request: Request, error: HTTPException) -> Problem:
    code = _BY_STATUS.get(error.status_code, "internal_error" if error.status_code >= 500 else "bad_request")
    details = {
        404: f"There is nothing at {request.url.path}.",
        405: f"{request.url.path} does not answer {request.method}.",
    }
    detail = details.get(error.status_code) or f"{HTTPStatus(error.status_code).phrase}: {error.detail}"
    hint = "See /docs for the routes." if error.status_code in details else None
    return Problem(code, detail, hint=hint, headers=error.headers, status=error.status_code)


def _methods(request: Request) -> list[str]:
    """Return the methods that the path of a request answers."""
    routes = [route for route in request.app.routes if isinstance(route, Route)]
    found = [route.methods or set() for route in routes if route.matches(request.scope)[0] is not Match.NONE]
    return sorted(set().union(*found))


def from_validation(errors: list[Any]) -> Problem:
    """Return the problem for pydantic's list of errors, naming each parameter."""
    faults = [{"parameter": ".".join(map(str, e["loc"])), "reason": str(e["msg"]).removesuffix(".")} for e in errors]
    detail = " ".join(f"{fault['parameter']}: {fault['reason']}." for fault in faults)
    return Problem("invalid_parameters", detail, hint="See /docs for the parameters.", errors=faults)


def disk_full() -> Problem:
    """Return the problem of what does not fit on the disk."""
    return Problem(
        "disk_full", "There is not enough disk space for this.", hint="Try again later.", headers={"Retry-After": "60"}
    )


def job_expired() -> Problem:
    """Return the problem of a job whose files have gone."""
    return Problem("job_expired", "The job has expired and its files were removed.", hint="Submit the file again.")


def unexpected() -> Problem:
    """Return the problem for an error of the service itself."""
    return Problem(
        "internal_error",
        "The service met an error of its own.",
        hint="The log of the service says more, under the X-Request-ID of this answer.",
    )


def install(app: FastAPI) -> None:
    """Answer every exception of `app` with a problem."""

    async def on_problem(request: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, Problem)
        return error.response(request)

    async def on_http(request: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, HTTPException)
        problem = _from_framework(request, error)
        if error.status_code == 405:  # the framework names the methods of the first route alone
            problem.headers["Allow"] = ", ".join(_methods(request))
        return problem.response(request)

    async def on_validation(request: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, RequestValidationError)
        located = [{"loc": e["loc"][1:] or e["loc"], "msg": e["msg"]} for e in error.errors()]
        return from_validation(located).response(request)

    async def on_database(request: Request, error: Exception) -> JSONResponse:
        if getattr(getattr(error, "orig", None), "sqlite_errorcode", None) == sqlite3.SQLITE_FULL:
            return disk_full().response(request)
        log.error("database error: %s", type(error).__name__, exc_info=error)
        problem = Problem("database_unavailable", "The job database did not answer.", headers={"Retry-After": "5"})
        return problem.response(request)

    async def on_system(request: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, OSError)
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise error
        return disk_full().response(request)

    async def on_storage(request: Request, error: Exception) -> JSONResponse:
        log.error("storage error on %s: %s", request.url.path, error)
        problem = Problem("storage_unavailable", "The storage did not answer.", headers={"Retry-After": "5"})
        return problem.response(request)

    async def on_error(request: Request, error: Exception) -> JSONResponse:  # noqa: ARG001
        return unexpected().response(request)

    app.add_exception_handler(Problem, on_problem)
    app.add_exception_handler(HTTPException, on_http)
    app.add_exception_handler(RequestValidationError, on_validation)
    app.add_exception_handler(SQLAlchemyError, on_database)
    app.add_exception_handler(OSError, on_system)
    app.add_exception_handler(StorageError, on_storage)
    app.add_exception_handler(Exception, on_error)
