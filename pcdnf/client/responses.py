"""Headers and errors of responses; a proxy may have answered instead of the service."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime

import httpx
from pydantic import ValidationError

from .errors import ProblemError
from .schemas import ProblemDetail


def error_of(response: httpx.Response) -> ProblemError:
    """Return the error that a response reports; its body must have been read."""
    status = response.status_code
    try:
        problem = ProblemDetail.model_validate_json(response.content).model_copy(update={"status": status})
    except ValidationError:
        problem = ProblemDetail(
            title=response.reason_phrase,
            status=status,
            detail=f"The response was {status} {response.reason_phrase} and did not come from the service.",
            code=f"http_{status}",
            hint="Check the address and any proxy in front of the service.",
        )
    return ProblemError(problem, retry_after=retry_after(response))


def retry_after(response: httpx.Response) -> float | None:
    """Seconds of ``Retry-After``, given as a number or a date; None without a valid one."""
    header = response.headers.get("retry-after", "")
    try:
        seconds = float(header)
    except ValueError:
        try:
            when = parsedate_to_datetime(header)
        except ValueError:
            return None
        if when.tzinfo is None:
            when = when.replace(tzinfo=UTC)
        seconds = (when - datetime.now(UTC)).total_seconds()
    return max(0.0, seconds) if math.isfinite(seconds) else None
