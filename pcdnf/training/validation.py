"""Validation of a training: fixed patches of held-out generated shapes."""

from __future__ import annotations

import numpy as np
import torch
from torch import nn

from .dataset import TrainingCloud, sample_batch
from .defaults import DEFAULTS
from .losses import Batch, angle_degrees, point_terms

VALIDATION_SEED = 1_000_000
"""Held-out shapes come from generators seeded here and above; training seeds stay below."""
VALIDATION_CLOUDS_A_BATCH = 8


def validation_batches(kind: str, patches: int, clouds: int) -> list[Batch]:
    """Fixed patches of held-out shapes, the same for every run of a kind."""
    rng = np.random.default_rng(VALIDATION_SEED)
    pool = [TrainingCloud(rng, DEFAULTS[kind].recipe, None) for _ in range(clouds)]
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
