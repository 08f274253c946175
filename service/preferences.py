"""``Prefer: wait=N`` (RFC 7240): how long a caller would wait for the answer itself."""

from __future__ import annotations

import re

from fastapi import Request

_WAIT = re.compile(r'^wait\s*=\s*"?(\d{1,9})"?\s*(?:;|$)', re.ASCII | re.IGNORECASE)


def preferred_wait(request: Request, longest: int) -> int | None:
    """Return the seconds asked for, at most `longest`; None where none were, or they are no number."""
    for header in request.headers.getlist("prefer"):
        for preference in header.split(","):
            match = _WAIT.match(preference.strip())
            if match is not None:  # the first of several counts
                return min(int(match[1]), longest)
    return None
