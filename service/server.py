"""The API process: ``python -m service.server``, on the supervisor's socket or on one of its own."""

from __future__ import annotations

import os
import signal
import socket

import uvicorn
from fastapi import FastAPI

from .app import create_app
from .process import configure_logging, die_with_supervisor, load_settings, refuse
from .protocol import Protocol
from .settings import Settings, SettingsError

SOCKET_VARIABLE = "PCDNF_SOCKET_FD"
BACKLOG = 2048
KEEP_ALIVE_SECONDS = 15


class Server(uvicorn.Server):
    """uvicorn, which ends the requests that wait for jobs before it waits for requests to end."""

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Close the listener and wait for the requests in hand."""
        app = self.config.app
        assert isinstance(app, FastAPI)
        app.state.watch.close()
        await super().shutdown(sockets)


def configuration(app: FastAPI, settings: Settings) -> uvicorn.Config:
    """Return how uvicorn serves the application."""
    return uvicorn.Config(
        app,
        http=Protocol,
        ws="none",
        log_config=None,
        access_log=settings.log_level == "debug",
        server_header=False,
        timeout_keep_alive=KEEP_ALIVE_SECONDS,
        timeout_graceful_shutdown=int(settings.grace_seconds),
    )


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
        listener = socket.socket(family, kind, protocol)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
    except OSError as error:
        raise SettingsError(
            f"Cannot listen on {settings.host} port {settings.port}: {error.strerror}. Set PCDNF_PORT or --port to a "
            "free one."
        ) from error
    listener.listen(BACKLOG)
    return listener


def url(settings: Settings, listener: socket.socket) -> str:
    """Return where the service is reached from this machine."""
    host = {"0.0.0.0": "127.0.0.1", "::": "[::1]"}.get(settings.host, settings.host)
    return f"http://{f'[{host}]' if ':' in host and host[0] != '[' else host}:{listener.getsockname()[1]}"


def main() -> None:
    """Serve until SIGTERM or SIGINT."""
    settings = load_settings()
    configure_logging(settings)
    die_with_supervisor()
    try:
        app = create_app(settings)
        inherited = os.environ.get(SOCKET_VARIABLE)
        listener = bind(settings) if inherited is None else socket.socket(fileno=int(inherited))
    except SettingsError as error:
        refuse(str(error))
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: None)  # uvicorn raises the signal again once it has shut down
    Server(configuration(app, settings)).run(sockets=[listener])


if __name__ == "__main__":
    main()
