"""Problems as HTTP responses: ``application/problem+json`` (RFC 9457), for routes and the framework's errors."""

from __future__ import annotations

import errno
import logging
import sqlite3
from http import HTTPStatus

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel, ConfigDict, Field
from sqlalchemy.exc import SQLAlchemyError
from starlette.exceptions import HTTPException
from starlette.routing import Match, Route

from ..database.damage import damage_of
from ..problems import Problem, database_problem, disk_full, from_validation, unexpected
from ..storage.base import StorageError

log = logging.getLogger(__name__)

MEDIA_TYPE = "application/problem+json"
LATER = "Try again after the number of seconds in Retry-After."


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
    detail: str = Field(description="What happened")
    instance: str | None = Field(None, description="The path of the request, or of the job")
    code: str = Field(description="Stable identifier for programs")
    hint: str | None = Field(None, description="What the caller can do about it")
    limit: int | float | None = Field(None, description="The limit that was exceeded")
    actual: int | float | None = Field(None, description="The value that exceeded it")


def respond(problem: Problem, request: Request) -> JSONResponse:
    """Return the HTTP response of a problem."""
    return JSONResponse(
        problem.body(request.url.path), status_code=problem.status, headers=problem.headers, media_type=MEDIA_TYPE
    )


def _from_framework(request: Request, error: HTTPException) -> Problem:
    code = _BY_STATUS.get(error.status_code, "internal_error" if error.status_code >= 500 else "bad_request")
    details = {
        404: f"There is no page at {request.url.path}.",
        405: f"{request.url.path} does not support the method {request.method}.",
    }
    detail = details.get(error.status_code) or f"{HTTPStatus(error.status_code).phrase}: {error.detail}"
    hint = "See /docs for the routes." if error.status_code in details else "See /docs for what this route accepts."
    return Problem(code, detail, hint=hint, headers=error.headers, status=error.status_code)


def _methods(request: Request) -> list[str]:
    """Return the methods that the path of a request answers."""
    routes = [route for route in request.app.routes if isinstance(route, Route)]
    found = [route.methods or set() for route in routes if route.matches(request.scope)[0] is not Match.NONE]
    return sorted(set().union(*found))


def install(app: FastAPI) -> None:
    """Answer every exception of `app` with a problem."""

    async def on_problem(request: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, Problem)
        return respond(error, request)

    async def on_http(request: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, HTTPException)
        problem = _from_framework(request, error)
        if error.status_code == 405:  # the framework names the methods of the first route alone
            problem.headers["Allow"] = ", ".join(_methods(request))
        return respond(problem, request)

    async def on_validation(request: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, RequestValidationError)
        located = [dict(fault) | {"loc": fault["loc"][1:] or fault["loc"]} for fault in error.errors()]
        return respond(from_validation(located), request)

    async def on_database(request: Request, error: Exception) -> JSONResponse:
        if getattr(getattr(error, "orig", None), "sqlite_errorcode", None) == sqlite3.SQLITE_FULL:
            return respond(disk_full(), request)
        damage = damage_of(error)
        log.error("database error: %s", damage or type(error).__name__, exc_info=None if damage else error)
        return respond(database_problem(damage), request)

    async def on_system(request: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, OSError)
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            return respond(disk_full(), request)
        damage = damage_of(error)
        if damage is None:
            raise error
        log.error("data folder: %s", damage)
        return respond(database_problem(damage), request)

    async def on_storage(request: Request, error: Exception) -> JSONResponse:
        log.error("storage error on %s: %s", request.url.path, error)
        problem = Problem(
            "storage_unavailable", "The storage did not answer.", hint=LATER, headers={"Retry-After": "5"}
        )
        return respond(problem, request)

    async def on_error(request: Request, error: Exception) -> JSONResponse:  # noqa: ARG001
        return respond(unexpected(), request)

    app.add_exception_handler(Problem, on_problem)
    app.add_exception_handler(HTTPException, on_http)
    app.add_exception_handler(RequestValidationError, on_validation)
    app.add_exception_handler(SQLAlchemyError, on_database)
    app.add_exception_handler(OSError, on_system)
    app.add_exception_handler(StorageError, on_storage)
    app.add_exception_handler(Exception, on_error)
