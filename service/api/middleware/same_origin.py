"""Only web pages of this service may call it, and those that the operator allows.

Any page in the user's browser can send a form to a service on the user's machine, and it can do harm without reading
the response. Browsers say in ``Sec-Fetch-Site`` or ``Origin`` which page sends a request; other programs send neither.
A page can also make its own host name point to this machine after it was loaded (DNS rebinding). The browser then
treats the service as the page's own origin. A service without keys on a loopback address therefore answers only if the
host name of the request is that of a loopback address.
"""

from __future__ import annotations

from urllib.parse import urlsplit

from fastapi import Request
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from ...exposure import is_loopback
from ...problems import Problem
from ...settings import Settings
from ..error_handlers import respond

SAFE_METHODS = ("GET", "HEAD", "OPTIONS")


class Origins:
    """Answers 403 to other sites' pages.

    Parameters
    ----------
    app : ASGI application
    settings : Settings
    """

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self._app = app
        self._own_names_only = not (settings.has_keys or settings.allow_anonymous)
        self._allowed = frozenset(settings.origins)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one connection (ASGI)."""
        if scope["type"] == "http":
            headers = Headers(scope=scope)
            problem = None
            if self._own_names_only and not _loopback_name(headers.get("host", "")):
                problem = Problem(
                    "cross_site",
                    "A service without keys answers only requests to a loopback address.",
                    hint="Use http://127.0.0.1 or http://localhost. Behind a proxy, set a key, or "
                    "PCDNF_ALLOW_ANONYMOUS=true if the proxy authenticates callers.",
                )
            elif scope["method"] not in SAFE_METHODS and not (
                _own_page(headers) or headers.get("origin", "").lower() in self._allowed
            ):
                problem = Problem(
                    "cross_site",
                    "The request came from a web page of another site.",
                    hint="Use the page of this service, or a program other than a browser.",
                )
            if problem is not None:
                await respond(problem, Request(scope))(scope, receive, send)
                return
        await self._app(scope, receive, send)


def _own_page(headers: Headers) -> bool:
    """Return whether a request comes from a page of this service, or from no page at all."""
    site = headers.get("sec-fetch-site")
    if site is not None:
        return site in ("same-origin", "none")
    origin = headers.get("origin")
    return origin is None or urlsplit(origin).netloc == headers.get("host", "")


def _loopback_name(host: str) -> bool:
    """Return whether a Host header names an address of this machine alone."""
    try:
        name = urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return False
    return is_loopback(name) or name.endswith(".localhost")
