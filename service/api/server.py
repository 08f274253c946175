"""The API process: ``python -m service.api``, on the socket of the supervisor or on its own."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import time
from types import FrameType

import uvicorn
from fastapi import FastAPI

from ..settings import Settings, SettingsError
from ..startup import load_settings, make_data_dir, observe, refuse, upgrade_database
from ..storage.open import open_storage
from ..supervision import SOCKET_VARIABLE, end_with_supervisor, is_supervised
from ..telemetry import tracing
from .app import STORAGE_SECONDS, create_app
from .http_protocol import Protocol
from .listener import bind

KEEP_ALIVE_SECONDS = 15


class Server(uvicorn.Server):
    """A uvicorn server that goes on answering until the requests in flight are finished.

    Under a supervisor it goes on until a second signal, which the supervisor sends when the worker has stopped.
    """

    def __init__(self, app: FastAPI, config: uvicorn.Config, grace_seconds: float) -> None:
        super().__init__(config)
        self._state, self._grace = app.state, grace_seconds
        self._signals = 0

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Shutdown: not ready and no new jobs from here on."""
        self._state.shutdown.begin()
        self._signals += 1
        super().handle_exit(sig, frame)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End the requests that wait for jobs, wait for the other ones, then close the listener."""
        deadline = time.monotonic() + self._grace
        self._state.watch.close()
        while (self._state.shutdown.in_flight or self._held) and time.monotonic() < deadline and not self.force_exit:
            await asyncio.sleep(0.05)
        self.config.timeout_graceful_shutdown = max(1, int(deadline - time.monotonic()))
        await super().shutdown(sockets)

    @property
    def _held(self) -> bool:
        return self._signals < 2 and is_supervised()


def configuration(app: FastAPI, settings: Settings) -> uvicorn.Config:
    """Return how uvicorn serves the application."""
    return uvicorn.Config(
        app,
        http=Protocol,
        ws="none",
        log_config=None,
        access_log=False,  # see service.api.middleware.access_log
        server_header=False,
        timeout_keep_alive=KEEP_ALIVE_SECONDS,
        timeout_graceful_shutdown=int(settings.grace_seconds),
    )


def main() -> None:
    """Serve until SIGTERM or SIGINT."""
    settings = load_settings()
    make_data_dir(settings)
    observe(settings, "pcdnf-api")
    end_with_supervisor()
    upgrade_database(settings)
    try:
        app = create_app(settings)
        open_storage(settings, patience=STORAGE_SECONDS)  # to report a wrong setting without a traceback
        inherited = os.environ.get(SOCKET_VARIABLE)
        listener = bind(settings) if inherited is None else socket.socket(fileno=int(inherited))
    except SettingsError as error:
        refuse(str(error))
    server = Server(app, configuration(app, settings), settings.grace_seconds)
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, server.handle_exit)  # uvicorn raises the signal again once it has shut down
    server.run(sockets=[listener])
    tracing.close()
