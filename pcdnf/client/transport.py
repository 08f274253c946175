"""Address and key of a service, and httpx's errors as errors of this package."""

from __future__ import annotations

import ssl
from collections.abc import Iterator
from contextlib import contextmanager

import httpx

from ..errors import PcdnfError
from .errors import UnreachableError

DEFAULT_URL = "http://127.0.0.1:8000"


def checked_url(url: str) -> str:
    """Check the address of a service; raise ``bad_url`` unless it is an http or https URL."""
    try:
        parsed = httpx.URL(url)
        good = parsed.scheme in ("http", "https") and bool(parsed.host) and "%" not in parsed.host
        good = good and 0 < (parsed.port or 80) < 65536
    except httpx.InvalidURL:
        good = False
    if not good:
        raise PcdnfError(
            "The address of the service is not an http or https URL.",
            code="bad_url",
            hint=f"Use an address such as {DEFAULT_URL} or https://denoise.example.org.",
        )
    return url


def checked_key(key: str) -> str:
    """Check that a key can be sent in a header; raise ``bad_key`` otherwise."""
    if not key.isascii() or not key.isprintable() or " " in key:
        raise PcdnfError(
            "The API key contains characters that are not allowed, such as spaces or line breaks.",
            code="bad_key",
            hint="Check PCDNF_API_KEY or the key file.",
        )
    return key


@contextmanager
def transport_errors(url: str) -> Iterator[None]:
    """Translate the errors of httpx into those of this package."""
    shown = str(httpx.URL(url).copy_with(userinfo=b""))
    try:
        yield
    except httpx.LocalProtocolError as error:
        raise PcdnfError(
            "The file changed while it was being uploaded.",
            code="file_changed",
            hint="Wait until the file is complete, then submit it again.",
        ) from error
    except httpx.TransportError as error:
        if _certificate(error):
            raise PcdnfError(
                f"The certificate of {shown} cannot be verified.",
                code="bad_certificate",
                hint="For a private authority, set SSL_CERT_FILE to its certificate.",
            ) from error
        what = "did not answer in time" if isinstance(error, httpx.TimeoutException) else "cannot be reached"
        raise UnreachableError(
            f"The service at {shown} {what} ({type(error).__name__}).",
            code="unreachable",
            hint="Check the address and whether the service is running.",
        ) from error


def _certificate(error: BaseException | None) -> bool:
    """Whether a failed certificate check caused an error."""
    while error is not None:
        if isinstance(error, ssl.SSLCertVerificationError):
            return True
        error = error.__cause__ or error.__context__
    return False
