"""What pages of the allowed other sites may do (CORS, WHATWG Fetch section 3.3)."""

from __future__ import annotations

from typing import Any

from ...settings import Settings

METHODS = ("GET", "HEAD", "POST", "DELETE")
REQUEST_HEADERS = (
    "Authorization",
    "Content-Disposition",
    "Content-Type",
    "Idempotency-Key",
    "If-Match",
    "If-None-Match",
    "Last-Event-ID",
    "Prefer",
    "Range",
    "X-Request-ID",
)
RESPONSE_HEADERS = (
    "Content-Disposition",
    "Content-Range",
    "ETag",
    "Link",
    "Location",
    "Preference-Applied",
    "Repr-Digest",
    "Retry-After",
    "Server-Timing",
    "X-Request-ID",
    "X-Total-Count",
)
PREFLIGHT_SECONDS = 600


def cross_origin(settings: Settings) -> dict[str, Any]:
    """Return the arguments of Starlette's ``CORSMiddleware``. Cookies play no part: callers send a key."""
    return {
        "allow_origins": settings.origins,
        "allow_methods": METHODS,
        "allow_headers": REQUEST_HEADERS,
        "expose_headers": RESPONSE_HEADERS,
        "allow_credentials": False,
        "max_age": PREFLIGHT_SECONDS,
    }
