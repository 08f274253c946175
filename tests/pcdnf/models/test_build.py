from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch

from pcdnf import Denoiser
from pcdnf.models.catalog import CheckpointError
from pcdnf.models.checkpoint import load_checkpoint, save_checkpoint


def changed(path: Path, *, drop: int = 0, **facts: Any) -> Path:
    """The default model with other facts, or without some tensors."""
    info, state = load_checkpoint("pcdnf-lite")
    given = {name: getattr(info, name) for name in ("name", "kind", "config", "recipe", "training", "licence")}
    save_checkpoint(path, dict(list(state.items())[drop:]), **given | facts)
    return path


def test_a_checkpoint_of_its_own_loads(tmp_path: Path) -> None:
    denoiser = Denoiser.load(changed(tmp_path / "m.safetensors", name="mine"), device="cpu")
    assert denoiser.info is not None
    assert denoiser.info.name == "mine"


@pytest.mark.parametrize(
    "facts",
    [
        {"config": {"depth_of_field": 3}},
        {"recipe": {"kind": "ball", "later_on": 1}},
        {"kind": "pcdnf", "config": {}},
        {"drop": 1},
    ],
    ids=["config", "recipe", "kind", "tensor"],
)
def test_facts_and_weights_of_no_network_are_refused(tmp_path: Path, facts: dict[str, Any]) -> None:
    with pytest.raises(CheckpointError, match=r"m\.safetensors does not match any network") as caught:
        Denoiser.load(changed(tmp_path / "m.safetensors", **facts), device="cpu")
    assert caught.value.code == "bad_checkpoint"
    assert caught.value.hint


def test_weights_of_another_shape_are_refused(tmp_path: Path) -> None:
    info, state = load_checkpoint("pcdnf-lite")
    name = next(iter(state))
    facts: dict[str, Any] = {
        key: getattr(info, key) for key in ("name", "kind", "config", "recipe", "training", "licence")
    }
    save_checkpoint(tmp_path / "m", state | {name: torch.zeros(1)}, **facts)
    with pytest.raises(CheckpointError, match="does not match"):
        Denoiser.load(tmp_path / "m", device="cpu")
