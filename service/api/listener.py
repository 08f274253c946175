"""The listening socket. It is bound before any process is started."""

from __future__ import annotations

import socket
from contextlib import ExitStack

from ..settings import Settings, SettingsError

BACKLOG = 2048


def bind(settings: Settings) -> socket.socket:
    """Return a socket bound to the address in the settings.

    Raises
    ------
    SettingsError
        If the address cannot be taken.
    """
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            settings.host, settings.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        with ExitStack() as unless_bound:
            listener = unless_bound.enter_context(socket.socket(family, kind, protocol))
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind(address)
            unless_bound.pop_all()
    except OSError as error:
        raise SettingsError(
            f"Cannot listen on {settings.host} port {settings.port}: {error.strerror}. Set PCDNF_PORT or --port to a "
            "free port."
        ) from error
    listener.listen(BACKLOG)
    return listener


def url(settings: Settings, listener: socket.socket) -> str:
    """Return the URL of the service on this machine."""
    host = {"0.0.0.0": "127.0.0.1", "::": "[::1]"}.get(settings.host, settings.host)
    return f"http://{f'[{host}]' if ':' in host and host[0] != '[' else host}:{listener.getsockname()[1]}"
