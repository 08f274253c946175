"""Validation of a training: fixed patches of held-out generated shapes and simulated scans."""

from __future__ import annotations

import numpy as np
import torch
from torch import nn

from ..scanners.catalog import KINDS
from .dataset import TrainingCloud, sample_batch, scan_samples, shape_sample
from .defaults import DEFAULTS
from .losses import Batch, angle_degrees, point_terms

VALIDATION_SEED = 1_000_000
"""Held-out shapes come from generators seeded here and above; training seeds stay below."""
VALIDATION_CLOUDS_A_BATCH = 8
CROPS = 6
"""Of each held-out scan."""


def validation_batches(kind: str, patches: int, clouds: int) -> list[Batch]:
    """Return fixed patches of held-out shapes, the same for every run of a kind."""
    rng = np.random.default_rng(VALIDATION_SEED)
    pool = [TrainingCloud(rng, shape_sample(rng), DEFAULTS[kind].recipe) for _ in range(clouds)]
    return _batches(pool, rng, patches)


def scan_batches(kind: str, patches: int, scans: int) -> list[Batch]:
    """Return fixed patches of held-out simulated scans, one scan of each kind in turn."""
    rng = np.random.default_rng(VALIDATION_SEED)
    kinds = list(KINDS)
    pool = [
        TrainingCloud(rng, sample, DEFAULTS[kind].recipe)
        for number in range(scans)
        for sample in scan_samples(rng, kinds[number % len(kinds)], VALIDATION_SEED + number, CROPS)
    ]
    return _batches(pool, rng, patches)


def _batches(pool: list[TrainingCloud], rng: np.random.Generator, patches: int) -> list[Batch]:
    size = min(256, patches)
    return [sample_batch(pool, rng, size, VALIDATION_CLOUDS_A_BATCH, 0.25) for _ in range(max(1, patches // size))]


@torch.no_grad()
def validate(network: nn.Module, batches: list[Batch]) -> dict[str, float]:
    """Projection distance (patch radii), distance to the nearest clean point and normal angle (degrees), means."""
    network.eval()
    sums: dict[str, float] = {"point": 0.0, "nearest": 0.0, "angle": 0.0}
    for batch in batches:
        output = network(batch.points, batch.normals)
        terms = point_terms(output.displacement, batch.surface)
        sums["point"] += float(terms.projection.mean())
        sums["nearest"] += float(terms.nearest.mean())
        sums["angle"] += float(angle_degrees(output.normal, terms.normal).mean())
    return {key: value / len(batches) for key, value in sums.items()}
