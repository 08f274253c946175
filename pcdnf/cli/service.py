"""The commands of the REST service, which is no part of the installed package: ``serve``, ``drain`` and ``doctor``.

The service lives in the folder ``service/`` of the repository and in the container image. Its own module
``service.cli`` completes these parsers; it is imported by name when one of the commands runs, so that ``pcdnf``
does not depend on it.
"""

from __future__ import annotations

import argparse
import importlib
from typing import TYPE_CHECKING

from ..errors import PcdnfError

if TYPE_CHECKING:
    Subparsers = argparse._SubParsersAction[argparse.ArgumentParser]

SERVICE_CLI = "service.cli"
COMMANDS = {
    "doctor": "check that everything the service needs is in order",
    "drain": "accept no new jobs, and finish those that were accepted",
    "serve": "run the REST service",
}


def add_service_commands(subparsers: Subparsers, *, command: str | None) -> None:
    """Add the commands of the service.

    Parameters
    ----------
    subparsers : argparse subparsers
        Of the parser of ``pcdnf``.
    command : str, optional
        The command that runs. If it is one of the service's, ``service.cli`` adds its options.

    Raises
    ------
    PcdnfError
        ``service_missing`` if ``command`` needs the service and it cannot be imported.
    """
    for name, what in COMMANDS.items():
        if name == command:
            getattr(_service_cli(), f"add_{name}")(subparsers)
        else:
            subparsers.add_parser(name, help=what)


def _service_cli() -> object:
    try:
        return importlib.import_module(SERVICE_CLI)
    except ModuleNotFoundError as error:
        if error.name not in ("service", SERVICE_CLI):
            raise
        raise PcdnfError(
            "The REST service is not part of the installed package.",
            code="service_missing",
            hint="Run scripts/serve in a clone of the repository, or the container image.",
        ) from None
