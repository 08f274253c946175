import json
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file

from pcdnf.models import catalog
from pcdnf.models.catalog import CheckpointError, available_models
from pcdnf.models.checkpoint import load_checkpoint, save_checkpoint

FACTS = {
    "name": "mine",
    "kind": "lite",
    "config": {"width": 8},
    "recipe": {"kind": "ball"},
    "training": {"steps": 3},
    "licence": "MIT",
}


def test_what_is_saved_comes_back(tmp_path: Path) -> None:
    path = tmp_path / "m.safetensors"
    save_checkpoint(path, {"a": torch.arange(6.0).view(2, 3).T}, **FACTS)  # type: ignore[arg-type]
    info, state = load_checkpoint(path)
    assert {key: getattr(info, key) for key in FACTS} == FACTS
    assert torch.equal(state["a"], torch.arange(6.0).view(2, 3).T)
    assert len(info.sha256) == 64
    assert [p.name for p in tmp_path.iterdir()] == ["m.safetensors"]


def test_shipped_models_have_metadata_and_the_pinned_hash() -> None:
    models = available_models()
    assert models[0].name == catalog.DEFAULT_MODEL
    assert {model.kind for model in models} == {"lite", "pcdnf"}
    for model in models:
        info, state = load_checkpoint(model.name)
        assert info.sha256 == model.sha256
        assert info.licence
        assert info.training["hours"] > 0
        assert state


def test_altered_weights_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save_checkpoint(tmp_path / "m.safetensors", {"a": torch.zeros(1)}, **FACTS)  # type: ignore[arg-type]
    (tmp_path / "index.json").write_text(json.dumps({"mine": {"file": "m.safetensors", "sha256": "0" * 64}}))
    monkeypatch.setattr(catalog, "WEIGHTS", tmp_path)
    with pytest.raises(CheckpointError, match="modified") as caught:
        load_checkpoint("mine")
    assert caught.value.code == "weights_altered"


@pytest.mark.parametrize("content", [b"", b"garbage" * 100, b"\xff" * 64])
def test_other_files_are_refused_with_advice(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "m.safetensors"
    path.write_bytes(content)
    with pytest.raises(CheckpointError, match="is not a checkpoint of this package"):
        load_checkpoint(path)


def test_foreign_and_later_safetensors_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "m.safetensors"
    save_file({"a": torch.zeros(1)}, path)
    with pytest.raises(CheckpointError, match="is not a checkpoint"):
        load_checkpoint(path)
    save_file({"a": torch.zeros(1)}, path, {"format": "99"})
    with pytest.raises(CheckpointError, match="newer version"):
        load_checkpoint(path)


def test_unknown_names_list_the_known_ones() -> None:
    with pytest.raises(CheckpointError, match="no model named 'nope'") as caught:
        load_checkpoint("nope")
    assert "pcdnf-lite" in str(caught.value.hint)


def test_a_format_that_is_no_number(tmp_path: Path) -> None:
    save_file({"a": torch.zeros(1)}, tmp_path / "m.safetensors", {"format": "[1]"})
    with pytest.raises(CheckpointError, match="is not a checkpoint"):
        load_checkpoint(tmp_path / "m.safetensors")


def test_a_place_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match="cannot be written") as caught:
        save_checkpoint(tmp_path / ("m" * 256), {"a": torch.zeros(1)}, **FACTS)  # type: ignore[arg-type]
    assert caught.value.code == "unwritable_file"
    with pytest.raises(CheckpointError, match="cannot be written"):
        save_checkpoint(tmp_path / "none" / "m", {"a": torch.zeros(1)}, **FACTS)  # type: ignore[arg-type]
