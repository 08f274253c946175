"""Problems: the one shape of every error that a caller can see (RFC 9457), without a web framework."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

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
    "already_finished": (409, "The job has finished"),
    "job_cancelled": (410, "The job was cancelled"),
    "job_expired": (410, "The job has expired"),
    "precondition_failed": (412, "The job has changed"),
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
