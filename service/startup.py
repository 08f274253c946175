"""What every process of the service does at its start: log, die with its supervisor, refuse with a sentence."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from typing import NoReturn

from pydantic import ValidationError

from .settings import Settings
from .telemetry import logs, tracing

EX_CONFIG = 78  # sysexits.h: the supervisor gives up instead of starting such a process again
SUPERVISOR_VARIABLE = "PCDNF_SUPERVISOR_PID"
_PR_SET_PDEATHSIG = 1


def observe(settings: Settings, service: str) -> None:
    """Begin to log and, where the environment asks for it, to trace under the name `service`."""
    logs.configure(settings)
    try:
        tracing.configure(service)
    except tracing.TracesMissing as error:
        refuse(str(error))


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
        return Settings()
    except ValidationError as error:
        for fault in error.errors():
            variable = "PCDNF_" + "_".join(str(part) for part in fault["loc"]).upper()
            print(f"pcdnf: {variable}: {fault['msg']}.", file=sys.stderr)
        sys.exit(EX_CONFIG)


def make_data_dir(settings: Settings) -> None:
    """Make the data folder where it is missing, or end the process with a sentence."""
    try:
        settings.data_dir.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        refuse(f"The data folder {settings.data_dir} cannot be made: {error.strerror}. Set PCDNF_DATA_DIR.")


def refuse(reason: str) -> NoReturn:
    """End the process because of how it was set up."""
    print(f"pcdnf: {reason}", file=sys.stderr)
    sys.exit(EX_CONFIG)
