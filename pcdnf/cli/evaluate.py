"""The command ``pcdnf evaluate``."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from ..file_formats import titles

if TYPE_CHECKING:
    Subparsers = argparse._SubParsersAction[argparse.ArgumentParser]


def add_evaluate(subparsers: Subparsers) -> None:
    """Add the command ``evaluate``."""
    parser = subparsers.add_parser(
        "evaluate",
        help="score a cloud against a clean one",
        description="Print the chamfer distance, the point-to-surface distance and the normal error, in units of the "
        "clean cloud's bounding-box diagonal. Clean normals are estimated if the file has none.",
    )
    parser.add_argument("prediction", type=Path, help=f"the cloud to score: {titles()}, or NPY (N, 3)")
    parser.add_argument("clean", type=Path, help="the clean cloud, in any of these formats")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=_evaluate)


def _evaluate(options: argparse.Namespace) -> int:
    from ..formats.files import read
    from ..metrics import score

    prediction, clean = read(options.prediction), read(options.clean)
    scores = score(prediction.points, prediction.normals, clean.points, clean.normals)
    if options.json:
        print(json.dumps(asdict(scores)))
        return 0
    print(f"points             {scores.points:,}")
    print(f"Chamfer distance   {scores.chamfer_distance:.3f} x 1e-5")
    print(f"point to surface   {scores.point_to_surface:.3f} x 1e-3")
    if scores.normal_mean is not None:
        print(f"normals            {scores.normal_mean:.2f} degrees mean, {scores.normal_rms:.2f} RMS")
    return 0
