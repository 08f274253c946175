"""Ablations: what each variant is, that all see the same patches, and the table beside the paper's."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from experiments import ablations
from experiments.ablations import Trainee, Variant, evaluate, table, train, trained
from pcdnf import Denoiser
from pcdnf.models.pcdnf import PCDNF
from pcdnf.training.losses import Batch


@pytest.fixture(autouse=True)
def few_clouds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ablations, "SHAPE_POINTS", 8000)


def test_variants_lack_what_the_paper_takes_out() -> None:
    assert Variant("full").config.anchor
    assert not Variant("full-plain").config.anchor
    v1, v3, v4 = (PCDNF(Variant(name).config) for name in ("V1", "V3-plain", "V4"))
    assert v1.selector is None
    assert v1.refinement is None
    assert PCDNF(Variant("V2").config).selector is not None
    assert (v3.normal_extractor, v3.decoder.normal) == (None, None)
    assert (v4.point_extractor, v4.decoder.coordinate) == (None, None)
    assert (Variant("V3").losses.normal, Variant("V4").losses.point, Variant("V2").losses.normal) == (0, 0, 10)


@pytest.mark.full
def test_variants_train_on_the_same_patches_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: dict[str, list[torch.Tensor]] = {}
    step = Trainee.step

    def watched(trainee: Trainee, batch: Batch, rate: float) -> dict[str, torch.Tensor]:
        seen.setdefault(trainee.variant.name, []).append(batch.points)
        return step(trainee, batch, rate)

    monkeypatch.setattr(Trainee, "step", watched)
    variants = [Variant("full"), Variant("V4")]
    options = {"steps": 2, "batch": 4, "seed": 0}
    paths = [tmp_path / f"{variant.name}.safetensors" for variant in variants]
    assert not trained(paths[0], options)
    train(variants, tmp_path, options, "cpu", 0)
    assert all(torch.equal(*pair) for pair in zip(seen["full"], seen["V4"], strict=True))
    assert not torch.equal(*seen["full"])
    assert all(trained(path, options) for path in paths)
    assert not trained(paths[0], options | {"steps": 3})

    denoisers = [Denoiser.load(path, device="cpu", precision="float32") for path in paths]
    figures = evaluate(denoisers, 0, 1.0, 60)
    assert figures == evaluate(denoisers, 0, 1.0, 60)
    assert figures[0]["noisy_p2s"] == figures[1]["noisy_p2s"]
    assert all(0 < each["denoised_p2s"] < each["noisy_p2s"] for each in figures)  # the anchor's fit


def test_the_table_stands_beside_the_papers() -> None:
    lines = [
        {"variant": name, "level": 1.0, "noisy_cd": 9.0, "noisy_rms": 30.0, "denoised_cd": cd, "denoised_rms": 20.0}
        for name, cd in (("V3", 1.0), ("V3", 2.0), ("V3-plain", 3.0))
    ]
    rows = table(lines, [Variant("V3"), Variant("V3-plain")], [1.0]).splitlines()
    assert rows == [
        "| variant | | 1 % |",
        "|---|---|---|",
        "| noisy | here | 9.00, 30.00 |",
        "| V3 | here | 1.50, – |",
        "| V3 | paper, no anchor | 1.39, – |",
        "| V3-plain | here | 3.00, – |",
    ]
