"""Ablations: what each variant is, that all see the same patches, and the table beside the paper's."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from benchmarks import ablations
from benchmarks.ablations import Variant, batches, evaluate, table, train, trained
from pcdnf import Denoiser
from pcdnf.network import PCDNF


@pytest.fixture(autouse=True)
def few_clouds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ablations, "POOL", 1)
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


def test_all_variants_see_the_same_patches() -> None:
    first, again = (list(batches(2, 8, 0)) for _ in range(2))
    for one, two in zip(first, again, strict=True):
        assert torch.equal(one.points, two.points)
    assert not torch.equal(first[0].points, first[1].points)
    assert not torch.equal(first[0].points, next(batches(1, 8, 1)).points)


def test_a_variant_is_trained_once_and_evaluated(tmp_path: Path) -> None:
    path = tmp_path / "V4.safetensors"
    assert not trained(path, steps=1, size=4, seed=0)
    train(Variant("V4"), path, steps=1, size=4, seed=0)
    assert trained(path, steps=1, size=4, seed=0)
    assert not trained(path, steps=2, size=4, seed=0)
    denoiser = Denoiser.load(path, device="cpu", precision="float32")
    figures = evaluate(denoiser, 0, 1.0, 60)
    assert figures == evaluate(denoiser, 0, 1.0, 60)
    assert 0 < figures["denoised_p2s"] < figures["noisy_p2s"]  # the anchor's fit


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
