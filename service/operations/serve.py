"""``pcdnf serve``: check the settings, bind the socket, upgrade the database, and become the supervisor."""

from __future__ import annotations

import os
import sys
from typing import NoReturn

from ..api.listener import bind, url
from ..exposure import check_exposure
from ..settings import Settings
from ..startup import upgrade_database


def serve(settings: Settings) -> NoReturn:
    """Replace this process by the supervisor of the service (:mod:`service.operations.supervisor`).

    The process keeps its id and the listening socket. What the checks imported, some 60 MB, is freed.

    Raises
    ------
    SettingsError
        If the service would be open to the network without a key, or the address cannot be taken.
    """
    check_exposure(settings)
    listener = bind(settings)
    upgrade_database(settings)
    os.set_inheritable(listener.fileno(), True)
    options = {
        "--socket": listener.fileno(),
        "--url": url(settings, listener),
        "--grace-seconds": settings.grace_seconds,
        "--log-level": settings.log_level,
        "--log-format": settings.log_format,
    }
    command = [sys.executable, "-m", "service.operations.supervisor"]
    sys.stdout.flush()
    sys.stderr.flush()
    os.execv(sys.executable, [*command, *(f"{name}={value}" for name, value in options.items())])
