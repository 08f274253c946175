from __future__ import annotations

from pathlib import Path

import pytest
import torch

from pcdnf.training.defaults import DEFAULTS
from pcdnf.training.loader import TrainingBatches, stream
from pcdnf.training.losses import Batch
from pcdnf.training.options import Options
from pcdnf.training.trainer import Trainer


def batches(seed: int = 3) -> TrainingBatches:
    recipe = DEFAULTS["lite"].recipe
    return TrainingBatches(recipe, seed=seed, batch=16, pool=1, fresh_every=100, teacher=None)


@pytest.mark.timeout(120)
def test_a_process_makes_the_same_batches() -> None:
    here = next(stream(batches(), processes=0, pin=False))
    there = next(stream(batches(), processes=1, pin=False))
    assert isinstance(there, Batch)
    assert torch.equal(here.points, there.points)
    assert torch.equal(here.surface.normals, there.surface.normals)
    other = next(stream(batches(seed=4), processes=0, pin=False))
    assert not torch.equal(here.points, other.points)


def test_the_network_in_training_becomes_its_own_teacher(tmp_path: Path) -> None:
    trainer = Trainer(Options(kind="lite", folder=tmp_path, minutes=1, first_pass="self", workers=0))
    ahead = trainer._teacher
    assert ahead is not None
    assert not ahead.ready.item()
    with torch.no_grad():
        trainer.average.first_score.bias.fill_(7)
    batch = next(iter(batches()))
    trainer._step(batch, 0.5)  # the optimiser's moments belong to the state
    trainer._checkpoint({"shapes": [batch]})
    assert not ahead.ready.item()  # too early
    trainer.run_folder.elapsed = 30
    trainer._checkpoint({"shapes": [batch]})
    assert ahead.ready.item() == 1
    assert ahead.network.first_score.bias.item() == pytest.approx(trainer.average.first_score.bias.item())
    assert all(parameter.is_shared() for parameter in ahead.network.parameters())


def test_a_shipped_model_is_a_teacher_at_once(tmp_path: Path) -> None:
    trainer = Trainer(Options(kind="lite", folder=tmp_path, minutes=1, first_pass="pcdnf-lite", workers=0))
    assert trainer._teacher is not None
    assert trainer._teacher.ready.item() == 1
