"""Short trainings without one ingredient or another."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from experiments import ingredients
from experiments.ingredients import CONDITIONS, PATCHES, Bank, data, draw, make_bank, optimisation
from pcdnf.training.losses import Batch


@pytest.fixture(scope="module")
def bank() -> Bank:
    return make_bank("sparse", 0)


def filled(value: float, like: Batch) -> Batch:
    """The batch with one number everywhere."""
    return like.each(lambda tensor: torch.full_like(tensor, value))


def test_a_bank_is_one_cloud_near_edges_and_anywhere(bank: Bank) -> None:
    for batch in (bank.edges, bank.anywhere):
        assert batch.points.shape == batch.clean_normals.shape == (PATCHES // 2, 256, 3)
        assert torch.equal(batch.points[:, 0], torch.zeros(PATCHES // 2, 3))
    assert not torch.equal(bank.edges.points, bank.anywhere.points)


def test_a_draw_has_its_share_of_edges(bank: Bank) -> None:
    known = Bank(filled(1, bank.edges), filled(0, bank.anywhere))
    batch = draw([known], np.random.default_rng(0), 640, 0.25)
    assert len(batch.points) == 640
    assert batch.points.shape[1] % 32 == 0
    assert batch.points.shape == batch.clean_points.shape
    assert float(batch.points.mean()) == pytest.approx(0.25, abs=0.05)
    assert float(draw([known], np.random.default_rng(0), 64, 0.0).points.max()) == 0


def test_what_is_left_out_is_not_seen(bank: Bank, monkeypatch: pytest.MonkeyPatch) -> None:
    clouds = {name: [Bank(bank.edges, bank.anywhere)] for name in CONDITIONS}
    seen: list[tuple[int, Any]] = []

    def train(banks: list[Bank], **given: Any) -> tuple[str, str]:
        seen.append((len(banks), given))
        return "network", "average"

    monkeypatch.setattr(ingredients, "train", train)
    monkeypatch.setattr(ingredients, "scores", lambda network, _: (2.0 if network == "average" else 4.0, 10.0))
    rows = list(data(clouds, clouds, 7, 64))
    assert [count for count, _ in seen] == [12, 12, 1] + 11 * [11]
    assert rows[1].startswith("| nothing | 2.00 |")
    assert rows[-1].startswith("| second pass | +0 % |")
    seen.clear()
    rows = list(optimisation(clouds, clouds, 8, 64))
    assert rows[1] == "| as it is | 2.000 | 10.00 | 4.000 |"
    assert {given["steps"] * given["batch"] for _, given in seen} == {512}


@pytest.mark.full
def test_training_learns(bank: Bank) -> None:
    first, later = (
        ingredients.scores(ingredients.train([bank], steps=steps, batch=64)[1], [bank])[0] for steps in (1, 12)
    )
    assert later < 0.9 * first
