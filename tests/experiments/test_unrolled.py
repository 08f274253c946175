"""Two passes over a crop, one differentiable in the other."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "experiments"))  # it is run from there

from trials import loaded
from unrolled import CENTRES, Cloud, Crop, first_pass, loss_of, second_pass

from pcdnf import Denoiser


@pytest.fixture(scope="module")
def crop() -> Crop:
    return Crop.random(Cloud(3), np.random.default_rng(0))


def test_its_first_pass_is_the_denoisers(crop: Crop) -> None:
    denoiser = Denoiser(loaded("pcdnf-lite"), crop.cloud.recipe)
    source, rows = crop.cloud.source, crop.rows[:CENTRES]
    expected = denoiser.inference.denoise(crop.cloud.noisy, source.normals, source, rows)
    with torch.no_grad():
        found = first_pass(loaded("pcdnf-lite"), Crop(crop.cloud, rows, CENTRES))
    moved = np.linalg.norm(expected.points - crop.cloud.noisy[rows], axis=1).mean()
    assert np.linalg.norm(found.points.numpy() - expected.points, axis=1).max() < 0.1 * moved  # bfloat16 there


def test_the_second_pass_sees_the_first_ones_points(crop: Crop) -> None:
    network = loaded("pcdnf-lite")
    with torch.no_grad():
        before = first_pass(network, crop)
        second = second_pass(network, crop, before)
    assert second.batch.points.shape == (CENTRES, 256, 3)
    assert second.batch.points.norm(dim=-1).max() < 1 + 1e-4
    assert second.batch.normals[..., 2].min() >= 0
    nearest = crop.cloud.tree.query(second.points.numpy())[0]
    assert np.median(nearest) < np.median(crop.cloud.tree.query(crop.cloud.noisy[crop.rows[:CENTRES]])[0])


@pytest.mark.full
def test_only_the_unrolled_loss_reaches_through(crop: Crop) -> None:
    network = loaded("pcdnf-lite").train()
    before = first_pass(network, crop)
    before.points.retain_grad()
    second_pass(network, crop, before).points.sum().backward()  # type: ignore[no-untyped-call]
    assert before.points.grad is not None
    assert before.points.grad[CENTRES:].abs().sum() > 0  # of neighbours that are no centres
    losses = {}
    for trial in ("one pass", "two passes", "unrolled"):
        network.zero_grad()
        loss = loss_of(trial, network, crop)
        loss.backward()  # type: ignore[no-untyped-call]
        losses[trial] = float(loss.detach())
    assert losses["unrolled"] == pytest.approx(losses["two passes"], rel=1e-3)
    assert losses["one pass"] < losses["two passes"]
