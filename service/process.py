"""What every process of the service does at its start: logging, dying with its supervisor, refusing with a sentence."""

from __future__ import annotations

import ctypes
import logging
import os
import signal
import sys
from typing import NoReturn

from pydantic import ValidationError

from .settings import Settings, SettingsError

EX_CONFIG = 78  # sysexits.h: the supervisor gives up instead of starting such a process again
SUPERVISOR_VARIABLE = "PCDNF_SUPERVISOR_PID"
_PR_SET_PDEATHSIG = 1


def configure_logging(settings: Settings) -> None:
    """Log to standard error; of the engine only warnings."""
    level = settings.log_level.upper()
    logging.basicConfig(level=level, format="%(asctime)s %(levelname)s %(process)d %(name)s: %(message)s")
    logging.getLogger("dbos").setLevel(level if level in ("DEBUG", "ERROR") else "WARNING")
    logging.getLogger("numba").setLevel("WARNING")


def die_with_supervisor() -> None:
    """Ask for SIGTERM when the supervisor dies, however it dies (Linux)."""
    supervisor = os.environ.get(SUPERVISOR_VARIABLE)
    if supervisor is None:
        return
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != int(supervisor):
        sys.exit(0)


def load_settings() -> Settings:
    """Return the settings, or end the process with a sentence on what is wrong with them."""
    try:
        settings = Settings()
        settings.check_exposure()
    except ValidationError as error:
        for fault in error.errors():
            variable = "PCDNF_" + "_".join(str(part) for part in fault["loc"]).upper()
            print(f"pcdnf: {variable}: {fault['msg']}.", file=sys.stderr)
        sys.exit(EX_CONFIG)
    except SettingsError as error:
        refuse(str(error))
    return settings


def refuse(reason: str) -> NoReturn:
    """End the process because of how it was set up."""
    print(f"pcdnf: {reason}", file=sys.stderr)
    sys.exit(EX_CONFIG)
