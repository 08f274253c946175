"""Problems: the shape of every error that a caller can see (RFC 9457). This module needs no web framework."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .faults import reason

# code -> (status, title). The codes are stable; programs compare them, not the text.
CATALOGUE: dict[str, tuple[int, str]] = {
    "bad_request": (400, "Bad request"),
    "not_authenticated": (401, "API key missing or unknown"),
    "cross_site": (403, "Request from another site"),
    "not_found": (404, "Page not found"),
    "job_not_found": (404, "Job not found"),
    "batch_not_found": (404, "Batch not found"),
    "display_not_found": (404, "No preview for this job"),
    "model_not_found": (404, "Model not found"),
    "method_not_allowed": (405, "Method not allowed"),
    "not_acceptable": (406, "Format not available"),
    "headers_too_slow": (408, "Headers arrived too slowly"),
    "upload_too_slow": (408, "Upload arrived too slowly"),
    "job_not_finished": (409, "Job not finished"),
    "idempotency_key_in_use": (409, "Idempotency key in use"),
    "job_failed": (409, "Job failed"),
    "already_finished": (409, "Job already finished"),
    "job_cancelled": (410, "Job cancelled"),
    "job_expired": (410, "Job expired"),
    "precondition_failed": (412, "Job has changed"),
    "upload_too_large": (413, "Upload too large"),
    "file_too_large": (413, "File too large"),
    "too_many_points": (413, "Too many points"),
    "too_much_work": (413, "Job too large"),
    "unsupported_media_type": (415, "Unsupported Content-Type"),
    "unsupported_encoding": (415, "Unsupported Content-Encoding"),
    "unknown_format": (415, "Unknown file format"),
    "missing_extra": (415, "Format not installed"),
    "range_not_satisfiable": (416, "Range not satisfiable"),
    "invalid_parameters": (422, "Invalid parameters"),
    "invalid_upload": (422, "Invalid upload"),
    "idempotency_key_reused": (422, "Idempotency key belongs to another request"),
    "empty_upload": (422, "Empty upload"),
    "normals_missing": (422, "Normals missing"),
    "not_enough_memory": (422, "File needs too much memory"),
    "took_too_long": (422, "File takes too long to read"),
    "headers_too_large": (431, "Headers too long"),
    "too_many_requests": (429, "Too many requests"),
    "quota_exceeded": (429, "Too many unfinished jobs"),
    "internal_error": (500, "Internal error"),
    "queue_full": (503, "Queue full"),
    "disk_full": (503, "Disk full"),
    "too_busy": (503, "Too many requests at once"),
    "not_ready": (503, "Service not ready"),
    "draining": (503, "Service is draining"),
    "stopping": (503, "Service is stopping"),
    "database_unavailable": (503, "Job database unavailable"),
    "database_corrupt": (503, "Job database damaged"),
    "data_read_only": (503, "Data folder read-only"),
    "storage_unavailable": (503, "Storage unavailable"),
    # How a job may fail; shown in the job's `problem`.
    "worker_lost": (500, "Worker crashed"),
    "model_changed": (500, "Model weights changed"),
    "workers_differ": (500, "Workers compute differently"),
    "out_of_memory": (500, "Out of memory"),
}


class Problem(Exception):  # noqa: N818  (see below)
    """An error to answer a caller with, named as in RFC 9457.

    The standard, its media type ``application/problem+json`` and the member ``problem`` of a job all use this word, so
    the name does not end in ``Error``.

    Parameters
    ----------
    code : str
        A key of :data:`CATALOGUE`, or with `status` and `title` given, any stable snake-case name.
    detail : str
        What happened, in a sentence.
    hint : str
        What the caller can do about it, in a sentence.
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
        hint: str,
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


def from_validation(errors: list[Any]) -> Problem:
    """Return the problem for pydantic's list of errors, naming each parameter."""
    faults = [{"parameter": ".".join(map(str, error["loc"])), "reason": reason(error)} for error in errors]
    detail = " ".join(f"{fault['parameter']}: {fault['reason']}." for fault in faults)
    return Problem("invalid_parameters", detail, hint="See /docs for the parameters and their values.", errors=faults)


def disk_full() -> Problem:
    """Return the problem for data that does not fit on the disk."""
    return Problem(
        "disk_full",
        "The service does not have enough disk space for this.",
        hint="Try again after the number of seconds in Retry-After.",
        headers={"Retry-After": "60"},
    )


_DATABASE = {
    "database_corrupt": "The job database of the service is damaged.",
    "data_read_only": "The service cannot write into its data folder.",
}


def database_problem(damage: str | None) -> Problem:
    """Return the problem for a job database or data folder that cannot be used.

    Parameters
    ----------
    damage : str or None
        ``database_corrupt``, ``data_read_only`` or ``database_locked``; None if it is not known what is wrong.
    """
    if damage in _DATABASE:
        hint = "Tell the operator of the service: `pcdnf doctor` on its machine says what to do."
        return Problem(damage, _DATABASE[damage], hint=hint, headers={"Retry-After": "60"})
    locked = damage == "database_locked"
    detail = "The job database is locked by another program." if locked else "The job database did not answer."
    hint = "Try again after the number of seconds in Retry-After."
    return Problem("database_unavailable", detail, hint=hint, headers={"Retry-After": "5"})


def job_expired() -> Problem:
    """Return the problem for a job whose files were removed."""
    return Problem("job_expired", "The job has expired and its files were removed.", hint="Submit the file again.")


def unexpected() -> Problem:
    """Return the problem for an error of the service itself."""
    return Problem(
        "internal_error",
        "The service failed because of an internal error.",
        hint="Look up the X-Request-ID of this response in the log of the service.",
    )
