"""Read a file under resource limits and say what it is: ``python -m pcdnf.formats.sandbox.check PATH``.

Prints one JSON object and ends with status 0, whatever the file holds::

    {"ok": true, "format": "ply", "points": 100000, "has_normals": false, "dropped": 0, "warnings": [],
     "diagonal": 1.7}
    {"ok": false, "code": "truncated", "detail": "…", "hint": "…", "limit": 1200180, "actual": 1048576}

A server calls it for each upload, so that no upload is parsed in the process that speaks HTTP.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..aside import points_to_fit
from ..files import is_text, read
from ..geographic import check_metric
from ..limits import Limits, bounds
from ..packed import is_packed, unpack
from .limits import add_restraints, guarded, restrain


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry of ``python -m pcdnf.formats.sandbox.check``."""
    parser = argparse.ArgumentParser(
        prog="python -m pcdnf.formats.sandbox.check", description="Check a point-cloud file."
    )
    parser.add_argument("path")
    parser.add_argument("--limits-json", default="{}", help="fields of pcdnf.formats.Limits")
    parser.add_argument("--text", action="store_true", help="without known first bytes it is columns of text")
    parser.add_argument("--unpack-to", help="where the cloud of a packed file goes")
    parser.add_argument("--max-unpacked", type=int, help="most bytes of it")
    parser.add_argument("--ignore-classes", type=json.loads, default=[], help="classes that are put aside: [7, 18]")
    add_restraints(parser)
    given = parser.parse_args(arguments)
    try:
        limits = Limits(**json.loads(given.limits_json))
    except (TypeError, ValueError) as error:
        parser.error(f"--limits-json: {error}")
    restrain(given.memory_bytes, given.cpu_seconds)
    print(json.dumps(guarded(lambda: _answer(given, limits))))


def _answer(given: argparse.Namespace, limits: Limits) -> dict[str, Any]:
    path, text, unpacked = given.path, given.text, {}
    if given.unpack_to is not None:
        with open(path, "rb") as file:
            if is_packed(file):
                with open(given.unpack_to, "wb") as target:
                    name = unpack(file, "", target, given.max_unpacked or limits.max_bytes)
                    unpacked = {"unpacked": target.tell()}
                path, text = given.unpack_to, text or is_text(name)
    return describe(path, limits, text=text, classes=given.ignore_classes) | unpacked


def describe(path: str, limits: Limits, *, text: bool, classes: Sequence[int] = ()) -> dict[str, Any]:
    """Return the object that :func:`main` prints for a file that can be read."""
    cloud = read(path, limits=limits, text=text)
    check_metric(cloud)
    cloud = points_to_fit(cloud, classes, limits)
    low, high = bounds(cloud.points) if len(cloud) else (0.0, 0.0)
    return {
        "ok": True,
        "format": cloud.flavour.format,
        "points": len(cloud),
        "has_normals": cloud.normals is not None,
        "dropped": len(cloud.dropped),
        "warnings": cloud.warnings,
        "diagonal": float(np.linalg.norm(high - low)),
    }


if __name__ == "__main__":
    main()
