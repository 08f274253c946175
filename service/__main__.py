"""``python -m service``: the same as ``pcdnf serve``."""

from __future__ import annotations

import argparse
import sys

from .cli import add_serve

parser = argparse.ArgumentParser(prog="python -m service")
add_serve(parser.add_subparsers(required=True))
arguments = parser.parse_args(["serve", *sys.argv[1:]])
sys.exit(arguments.run(arguments))
