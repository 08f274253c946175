"""Write a cloud in another format under resource limits.

``python -m pcdnf.formats.sandbox.convert SOURCE TARGET FORMAT``

Prints one JSON object and ends with status 0, as ``pcdnf.formats.sandbox.check`` does::

    {"ok": true, "warnings": ["PLY holds per-point values only; 'origin' was left out."]}

A server calls it for a result that is asked for in another format than it was stored in.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from typing import Any, get_args

from ...file_formats import available
from ..coordinates import Coordinates
from ..files import read, write
from ..limits import Limits
from .limits import add_restraints, guarded, restrain


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry of ``python -m pcdnf.formats.sandbox.convert``."""
    parser = argparse.ArgumentParser(
        prog="python -m pcdnf.formats.sandbox.convert", description="Convert a point-cloud file."
    )
    parser.add_argument("source")
    parser.add_argument("target")
    parser.add_argument("format", choices=available())
    parser.add_argument("--coordinates", choices=get_args(Coordinates), default="keep")
    add_restraints(parser)
    given = parser.parse_args(arguments)
    restrain(given.memory_bytes, given.cpu_seconds)
    print(json.dumps(guarded(lambda: convert(given.source, given.target, given.format, given.coordinates))))


def convert(source: str, target: str, format_: str, coordinates: Coordinates = "keep") -> dict[str, Any]:
    """Return the object that :func:`main` prints after success."""
    cloud = read(source, limits=Limits())
    return {"ok": True, "warnings": write(target, cloud, format=format_, coordinates=coordinates)}


if __name__ == "__main__":
    main()
