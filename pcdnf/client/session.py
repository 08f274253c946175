"""Requests to one service: its address and key, the timeouts, and repetition while the service is busy."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import httpx

from .._version import __version__
from .responses import error_of
from .retries import Notify, Retries
from .transfers import Download
from .transport import checked_key, checked_url, transport_errors

TIMEOUT = httpx.Timeout(60, connect=10)
"""Seconds of a short request."""
LONG_TIMEOUT = httpx.Timeout(60, connect=10, read=300)
"""Seconds of an upload, which is checked before it is answered, and of a result, which may be converted first."""


class Session:
    """The connections to one service.

    Parameters
    ----------
    url : str
        Address of the service.
    key : str, optional
        Sent as ``Authorization: Bearer``.
    patience : float
        Seconds for which a request is repeated while the service is busy or cannot be reached.
    on_retry : callable, optional
        Called with the error and the seconds of each pause.

    Raises
    ------
    PcdnfError
        ``bad_url`` or ``bad_key``.
    """

    def __init__(self, url: str, key: str | None, patience: float, on_retry: Notify | None) -> None:
        self.url = checked_url(url)
        headers = {"User-Agent": f"pcdnf/{__version__}"}
        if key:
            headers["Authorization"] = f"Bearer {checked_key(key)}"
        self._retries = Retries(patience, on_retry)
        self._http = httpx.Client(base_url=self.url, headers=headers, timeout=TIMEOUT)

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    def send(self, method: str, path: str, **options: Any) -> httpx.Response:
        """Send a request, with httpx's options, and return the response.

        Parameters
        ----------
        method, path : str
            The path is relative to the address.
        **options
            Of :meth:`httpx.Client.request`.

        Returns
        -------
        httpx.Response
            2xx or 304.

        Raises
        ------
        ProblemError, UnreachableError
            The last error, once the patience is used up.
        """

        def attempt() -> httpx.Response:
            with transport_errors(self.url):
                response = self._http.request(method, path, **options)
            if response.is_success or response.status_code == 304:
                return response
            raise error_of(response)

        return self._retries.run(attempt, also=frozenset({409}) if method == "POST" else frozenset())

    def fetch(self, path: str, params: Mapping[str, str], download: Download) -> None:
        """Write the body of a response to a download, over several connections if need be.

        Raises
        ------
        ProblemError, UnreachableError
            As :meth:`send`.
        """

        def attempt() -> None:
            headers = {"Accept-Encoding": "identity"} | download.headers
            with (
                transport_errors(self.url),
                self._http.stream("GET", path, params=params, headers=headers, timeout=LONG_TIMEOUT) as response,
            ):
                if not response.is_success:
                    response.read()
                    raise error_of(response)
                download.take(response)

        self._retries.run(attempt)
