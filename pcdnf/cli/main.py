"""``pcdnf``: the command line.

Each command is a function ``add_<name>(subparsers)`` that adds its parser and sets ``run``, a function of the
parsed arguments that returns the exit status. Packages add theirs through the entry-point group
``pcdnf.commands``. Nothing heavy is imported before a command runs.

Exit status: 0 done, 1 some of several files failed (``submit``), 2 refused (one line on standard error says why and
what to do), 130 interrupted.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib.metadata import entry_points

from .._version import __version__
from ..errors import PcdnfError
from .benchmark import add_benchmark
from .denoise import add_denoise
from .evaluate import add_evaluate
from .import_weights import add_import_weights
from .models import add_models
from .render import add_render
from .submit import add_jobs, add_submit
from .train import add_train

COMMAND_GROUP = "pcdnf.commands"
REFUSED = 2
INTERRUPTED = 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    options = build_parser().parse_args(arguments)
    try:
        status: int = options.run(options)
    except PcdnfError as error:
        print(f"pcdnf: {error}{f' {error.hint}' if error.hint else ''}", file=sys.stderr)
        return REFUSED
    except KeyboardInterrupt:
        print("pcdnf: Interrupted.", file=sys.stderr)
        return INTERRUPTED
    return status


def build_parser() -> argparse.ArgumentParser:
    """Make the parser of all commands."""
    parser = argparse.ArgumentParser(prog="pcdnf", description="Denoise point clouds: PCDNF (TVCG 2023).")
    parser.add_argument("--version", action="version", version=f"pcdnf {__version__}")
    subparsers = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    add_denoise(subparsers)
    for entry in sorted(entry_points(group=COMMAND_GROUP), key=lambda entry: entry.name):
        entry.load()(subparsers)
    add_submit(subparsers)
    add_jobs(subparsers)
    add_evaluate(subparsers)
    add_render(subparsers)
    add_benchmark(subparsers)
    add_models(subparsers)
    add_train(subparsers)
    add_import_weights(subparsers)
    return parser
