"""What the light network's last fit owes to its parts, without training anew: a row for each other fit.

    python experiments/fits.py [MODEL] [--patches 2048]

Mean projection distance to the clean surface (patch radii) and normal error (degrees) on the patches that a training
validates on. Needs the ``train`` extra.
"""

from __future__ import annotations

import argparse
from typing import Any

import torch

from pcdnf.models import lite
from pcdnf.models.build import build_network
from pcdnf.models.catalog import DEFAULT_MODEL
from pcdnf.models.checkpoint import load_checkpoint
from pcdnf.models.quadric import QuadricFit, fit_quadric
from pcdnf.training.validation import validate, validation_batches

STIFF = 1e4
"""Ridge that leaves nothing of a coefficient."""
FITS = ("as trained", "plane", "points alone", "equal weights", "weights by distance", "reweighted once", "twice")


def other_fit(name: str) -> Any:
    """In place of ``fit_quadric``; the first of the two fits, which has no normals, stays."""

    def fit(points: torch.Tensor, weights: torch.Tensor, **parts: Any) -> QuadricFit:
        if "normals" not in parts or name == "as trained":
            return fit_quadric(points, weights, **parts)
        real = (weights > 0).float()
        if name == "plane":
            parts["ridge"] = parts["ridge"] + STIFF * torch.tensor([0.0, 0, 0, 1, 1, 1])
        elif name == "points alone":
            parts["normals"] = parts["slope_weights"] = None
        elif name == "equal weights":
            weights = real
        elif name == "weights by distance":
            weights = real * torch.exp(-4 * points.square().sum(-1))
        for _ in range(("reweighted once", "twice").index(name) + 1 if name in ("reweighted once", "twice") else 0):
            height, *_ = fit_quadric(points, weights, **parts).at(points[..., 0], points[..., 1])
            away = (points[..., 2] - height).abs()  # (B, M)
            usual = (weights * away).sum(1, keepdim=True) / weights.sum(1, keepdim=True)
            weights = weights / (1 + (away / (2 * usual)).square())  # Cauchy
        return fit_quadric(points, weights, **parts)

    return fit


def main() -> None:
    """Validate with each fit."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model", nargs="?", default=DEFAULT_MODEL)
    parser.add_argument("--patches", type=int, default=2048)
    parser.add_argument("--clouds", type=int, default=12)
    arguments = parser.parse_args()
    info, state = load_checkpoint(arguments.model)
    network = build_network(info.kind, info.config)
    network.load_state_dict(state)
    batches = validation_batches(info.kind, arguments.patches, arguments.clouds)
    print("| fit | point | angle |\n|---|---|---|")
    for name in FITS:
        lite.fit_quadric = other_fit(name)
        scores = validate(network, batches)
        print(f"| {name} | {scores['point']:.4f} | {scores['angle']:.2f} |", flush=True)


if __name__ == "__main__":
    main()
