"""The losses that were tried."""

from __future__ import annotations

from types import SimpleNamespace

import torch

from experiments.trials import TRIALS, loss_of
from pcdnf.training.losses import Batch, Surface


def corner() -> Batch:
    """A patch of two walls; the centre's is z = 0."""
    generator = torch.Generator().manual_seed(0)
    points = torch.rand(1, 100, 3, generator=generator)
    points[0, :50, 2] = 0
    points[0, 50:, 0] = 1
    points[0, 0] = 0
    normals = torch.zeros(1, 100, 3)
    normals[0, :50, 2], normals[0, 50:, 0] = 1, 1
    return Batch(points, normals, Surface(points[:, :40], normals[:, :40]), points, normals)


def test_every_trial_changes_the_loss() -> None:
    generator = torch.Generator().manual_seed(1)
    batch = corner()
    turned = torch.nn.functional.normalize(torch.randn(1, 3, generator=generator), dim=-1)
    output = SimpleNamespace(
        displacement=torch.full((1, 3), 0.1), normal=turned, weight=torch.rand(1, 100, generator=generator)
    )
    teacher = SimpleNamespace(displacement=torch.zeros(1, 3), normal=torch.tensor([[0.0, 0.0, 1.0]]))
    losses = {trial: loss_of(trial, output, batch, teacher).item() for trial in TRIALS}
    assert len(set(losses.values())) == len(TRIALS)
    assert losses["points alone"] < losses["control"] < losses["distilled"]
