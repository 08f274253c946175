"""``pcdnf``: the command line.

Each command is a function ``add_<name>(subparsers)`` that adds its parser and sets ``run``, a function of the
parsed arguments that returns the exit status. Nothing heavy is imported before a command runs.

Exit status: 0 done, 1 some of several files failed (``submit``), 2 refused (one line on standard error says why and
what to do), 130 interrupted.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from .._version import __version__
from ..errors import PcdnfError, missing_extra
from .benchmark import add_benchmark
from .denoise import add_denoise
from .evaluate import add_evaluate
from .import_weights import add_import_weights
from .models import add_models
from .render import add_render
from .service import add_service_commands
from .submit import add_jobs, add_submit
from .train import add_train

REFUSED = 2
INTERRUPTED = 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    try:
        return _run(given)
    except PcdnfError as error:
        print(f"pcdnf: {error}{f' {error.hint}' if error.hint else ''}", file=sys.stderr)
        return REFUSED
    except KeyboardInterrupt:
        print("pcdnf: Interrupted.", file=sys.stderr)
        return INTERRUPTED


def _run(given: Sequence[str]) -> int:
    command = next((word for word in given if not word.startswith("-")), None)
    try:
        options = build_parser(command=command).parse_args(given)
        status: int = options.run(options)
    except ModuleNotFoundError as error:
        raise missing_extra(error) from error
    return status


def build_parser(command: str | None = None) -> argparse.ArgumentParser:
    """Make the parser of all commands; those of the service are complete only when they are ``command``."""
    parser = argparse.ArgumentParser(prog="pcdnf", description="Denoise point clouds: PCDNF (TVCG 2023).")
    parser.add_argument("--version", action="version", version=f"pcdnf {__version__}")
    subparsers = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    add_denoise(subparsers)
    add_service_commands(subparsers, command=command)
    add_submit(subparsers)
    add_jobs(subparsers)
    add_evaluate(subparsers)
    add_render(subparsers)
    add_benchmark(subparsers)
    add_models(subparsers)
    add_train(subparsers)
    add_import_weights(subparsers)
    return parser
