"""The commands of the service: ``pcdnf serve``, ``pcdnf drain`` and ``pcdnf doctor``."""

from __future__ import annotations

import argparse
import json
import os
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    Subparsers = argparse._SubParsersAction[argparse.ArgumentParser]

# Options that override a setting. All other settings come from the environment.
OPTIONS = {
    "host": "address to listen on",
    "port": "port to listen on; 0 chooses a free port",
    "data-dir": "folder for uploads, results and the job database",
    "device": "auto, cpu or cuda:N",
}
SETTINGS = (
    "The settings are PCDNF_* environment variables, listed in docs/settings.md. An option overrides its setting."
)


def add_serve(subparsers: Subparsers) -> None:
    """Add the command ``serve`` to the parser of ``pcdnf``."""
    parser = subparsers.add_parser(
        "serve",
        help="run the REST service",
        description=f"Run the API and a worker until SIGTERM or Ctrl-C. {SETTINGS}",
    )
    _add_options(parser, *OPTIONS)
    parser.set_defaults(run=serve)


def add_drain(subparsers: Subparsers) -> None:
    """Add the command ``drain``."""
    parser = subparsers.add_parser(
        "drain",
        help="stop accepting new jobs and finish the accepted ones",
        description="Stop accepting new jobs, in every API process on this job database, until "
        "--off. Accepted jobs are finished. "
        f"{SETTINGS}",
    )
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--off", action="store_true", help="accept new jobs again")
    what.add_argument("--status", action="store_true", help="print the state of the service, change nothing")
    parser.add_argument("--wait", action="store_true", help="wait until all jobs are finished")
    _add_options(parser, "data-dir")
    parser.set_defaults(run=drain)


def add_doctor(subparsers: Subparsers) -> None:
    """Add the command ``doctor``."""
    parser = subparsers.add_parser(
        "doctor",
        help="check everything the service needs",
        description="Check Python, device, weights, data folder, disk, storage, job database, keys, "
        "port, and a running "
        f"service. The exit status is 1 if there is a problem. {SETTINGS}",
    )
    parser.add_argument("--json", action="store_true", help="print the findings as a JSON array")
    _add_options(parser, *OPTIONS)
    parser.set_defaults(run=doctor)


def serve(arguments: argparse.Namespace) -> NoReturn:
    """Run the service until SIGTERM or Ctrl-C."""
    _take_options(arguments)
    from .operations.serve import serve
    from .settings import SettingsError
    from .startup import configure_logs, load_settings, make_data_dir, refuse

    settings = load_settings()
    make_data_dir(settings, thorough=True)
    configure_logs(settings)
    try:
        serve(settings)
    except SettingsError as error:
        refuse(str(error))


def drain(arguments: argparse.Namespace) -> int:
    """Turn draining on or off; return the exit status."""
    _take_options(arguments)
    from .operations.drain import drain
    from .settings import SettingsError
    from .startup import load_settings, refuse

    try:
        drain(load_settings(), on=None if arguments.status else not arguments.off, wait=arguments.wait)
    except SettingsError as error:
        refuse(str(error))
    return 0


def doctor(arguments: argparse.Namespace) -> int:
    """Print the findings; return 1 if there is a problem."""
    _take_options(arguments)
    from .operations.doctor import examine, print_finding
    from .startup import load_settings

    found = []
    for finding in examine(load_settings()):
        found.append(finding)
        if not arguments.json:
            print_finding(finding)
    if arguments.json:
        print(json.dumps([finding.to_json() for finding in found], indent=1))
    return 1 if any(finding.level == "problem" for finding in found) else 0


def _add_options(parser: argparse.ArgumentParser, *names: str) -> None:
    for name in names:
        parser.add_argument(f"--{name}", help=OPTIONS[name])


def _take_options(arguments: argparse.Namespace) -> None:
    """Set the environment variables of the given options, for this process and its children."""
    for name in OPTIONS:
        value = getattr(arguments, name.replace("-", "_"), None)
        if value is not None:
            os.environ[f"PCDNF_{name.replace('-', '_').upper()}"] = value
