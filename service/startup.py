"""The start of every process of the service: read the settings, begin to log, refuse with a message."""

from __future__ import annotations

import sys
from typing import NoReturn

from pydantic import ValidationError

from .faults import reason
from .settings import Settings
from .supervision import EX_CONFIG
from .telemetry import logs, tracing


def configure_logs(settings: Settings) -> None:
    """Begin to log as `settings` ask."""
    logs.configure(settings.log_level, settings.log_format)


def observe(settings: Settings, service: str) -> None:
    """Begin to log and, if the environment asks for it, to trace under the name `service`."""
    configure_logs(settings)
    try:
        tracing.configure(service)
    except tracing.TracesMissingError as error:
        refuse(str(error))


def load_settings() -> Settings:
    """Return the settings, or end the process with a message for each wrong one."""
    try:
        return Settings()
    except ValidationError as error:
        for fault in error.errors():
            variable = "PCDNF_" + "_".join(str(part) for part in fault["loc"]).upper()
            print(f"pcdnf: {variable}: {reason(fault)}.", file=sys.stderr)
        sys.exit(EX_CONFIG)


def make_data_dir(settings: Settings) -> None:
    """Create the data folder if it is missing, or end the process with a message."""
    try:
        settings.data_dir.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        refuse(
            f"The data folder {settings.data_dir} cannot be created: {error.strerror}. Set "
            "PCDNF_DATA_DIR to another folder."
        )


def refuse(reason: str) -> NoReturn:
    """End the process with a message, because it was set up wrongly."""
    print(f"pcdnf: {reason}", file=sys.stderr)
    sys.exit(EX_CONFIG)
