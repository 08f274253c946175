"""The start of every process of the service: read the settings, begin to log, refuse with a message."""

from __future__ import annotations

import sqlite3
import sys
from typing import NoReturn

from pydantic import ValidationError
from sqlalchemy.exc import SQLAlchemyError

from .database.damage import DamageError, check_data, damage_of, database_file
from .database.migrations import migrate
from .faults import reason
from .settings import Settings
from .supervision import EX_CONFIG, say_refusal
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
            say_refusal(f"{variable}: {reason(fault)}.")
        sys.exit(EX_CONFIG)


def make_data_dir(settings: Settings, *, thorough: bool = False) -> None:
    """Create the data folder if it is missing and check what is in it, or end the process with a message.

    Parameters
    ----------
    settings : Settings
    thorough : bool
        Whether every page of the job database is read.
    """
    try:
        settings.data_dir.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        refuse(
            f"The data folder {settings.data_dir} cannot be created: {error.strerror}. Set "
            "PCDNF_DATA_DIR to another folder."
        )
    try:
        check_data(settings, thorough=thorough)
    except DamageError as error:
        refuse(str(error))


def upgrade_database(settings: Settings) -> None:
    """Create or upgrade the job database, or end the process with a message if it is damaged."""
    try:
        migrate(settings)
    except (SQLAlchemyError, sqlite3.Error, OSError) as error:
        code = damage_of(error)
        if code is None:
            raise
        refuse(str(DamageError(code, database_file(settings))))


def refuse(reason: str) -> NoReturn:
    """End the process with a message, because it was set up wrongly."""
    say_refusal(reason)
    sys.exit(EX_CONFIG)
