"""``pcdnf serve``: the whole service from one command."""

from __future__ import annotations

import argparse
import os
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    Subparsers = argparse._SubParsersAction[argparse.ArgumentParser]

# Options that stand for a setting; every other setting comes from the environment.
OPTIONS = {
    "host": "address to listen on",
    "port": "port to listen on; 0 picks a free one",
    "data-dir": "folder of uploads, results and the job database",
    "device": "auto, cpu or cuda:N",
}


def add_serve(subparsers: Subparsers) -> None:
    """Add the command ``serve`` to the parser of ``pcdnf``."""
    parser = subparsers.add_parser(
        "serve",
        help="run the REST service",
        description="Run the API and a worker until SIGTERM or Ctrl-C. Settings are PCDNF_* environment variables, "
        "listed in docs/settings.md; an option here wins.",
    )
    for name, help_ in OPTIONS.items():
        parser.add_argument(f"--{name}", help=help_)
    parser.set_defaults(run=serve)


def serve(arguments: argparse.Namespace) -> int:
    """Run the service; return the exit status."""
    for name in OPTIONS:
        value = getattr(arguments, name.replace("-", "_"))
        if value is not None:
            os.environ[f"PCDNF_{name.replace('-', '_').upper()}"] = value
    from . import logs
    from .process import load_settings, refuse
    from .server import bind
    from .settings import SettingsError
    from .supervisor import supervise

    settings = load_settings()
    logs.configure(settings)
    try:
        settings.check_exposure()
        listener = bind(settings)
    except SettingsError as error:
        refuse(str(error))
    return supervise(settings, listener)
