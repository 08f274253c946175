from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from pcdnf import Denoiser
from pcdnf.inference.device import DeviceError
from pcdnf.inference.runner import BATCH, SMALLEST_BATCH, Inference, batch_for


def sheet(count: int) -> np.ndarray:
    """A wavy sheet with noise."""
    place = np.random.default_rng(0).uniform(size=(count, 2))
    height = 0.1 * np.sin(5 * place[:, :1]) + 0.01 * np.random.default_rng(1).normal(size=(count, 1))
    return np.concatenate([place, height], axis=1)


@pytest.fixture
def tried(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """The batches that were tried, on a device that ``holds`` so many patches."""
    seen: dict[str, Any] = {"holds": 10**9, "batches": []}
    network = Inference.network

    def small(self: Inference, points: torch.Tensor, normals: torch.Tensor) -> Any:
        seen["batches"].append(len(points))
        if len(points) > seen["holds"]:
            raise torch.OutOfMemoryError("injected")
        return network(self, points, normals)

    monkeypatch.setattr(Inference, "network", small)
    return seen


def test_out_of_device_memory_halves_the_batch_and_loses_nothing(tried: dict[str, Any]) -> None:
    points = sheet(700)
    expected = Denoiser.load("pcdnf-lite", device="cpu").denoise(points, iterations=1)
    tried["holds"], tried["batches"] = 100, []
    denoiser, told = Denoiser.load("pcdnf-lite", device="cpu"), list[int]()
    found = denoiser.denoise(points, iterations=1, progress=lambda done, _: told.append(done))
    assert tried["batches"] == [512, 256, 128] + 11 * [64]
    assert denoiser.batch == 64
    assert told == [*range(64, 700, 64), 700]
    np.testing.assert_allclose(found.points, expected.points, atol=1e-6)


@pytest.mark.parametrize(
    ("kind", "free", "batch"),
    [("lite", 70 << 30, 8192), ("lite", 5 << 30, 2048), ("pcdnf", 2 << 30, 128), ("pcdnf", 1, 8)],
)
def test_a_batch_suits_the_memory_that_is_free(
    kind: str, free: int, batch: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda _: (free, 80 << 30))
    assert batch_for(kind, "cuda:0") == batch
    assert batch_for(kind, "cpu") == BATCH[kind]


def test_a_device_too_small_for_any_batch(tried: dict[str, Any]) -> None:
    tried["holds"] = 0
    with pytest.raises(DeviceError) as caught:
        Denoiser.load("pcdnf-lite", device="cpu").denoise(sheet(300))
    assert caught.value.code == "out_of_memory"
    assert caught.value.hint
    assert tried["batches"][-1] == SMALLEST_BATCH


def test_a_cloud_begins_with_the_whole_batch_again(tried: dict[str, Any]) -> None:
    denoiser, points = Denoiser.load("pcdnf-lite", device="cpu"), sheet(300)
    tried["holds"] = 100
    denoiser.denoise(points, iterations=1)
    tried["holds"], tried["batches"] = 10**9, []
    denoiser.denoise(points, iterations=1)
    assert tried["batches"] == [512]
    denoiser.batch, tried["batches"] = 200, []
    denoiser.denoise(points, iterations=1)
    assert tried["batches"] == [200, 200], "the caller's, where one is set"


def test_no_room_for_the_network(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.nn.Module, "to", full)
    with pytest.raises(DeviceError, match="with the network") as caught:
        Denoiser.load("pcdnf-lite", device="cpu")
    assert (caught.value.code, bool(caught.value.hint)) == ("out_of_memory", True)


def full(*_: object, **__: object) -> None:
    raise torch.OutOfMemoryError("injected")


def test_no_room_for_the_cloud(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pcdnf.inference.prepare.DevicePatchSource", full)
    denoiser = Denoiser.load("pcdnf-lite", device="cpu")
    denoiser.device = "cuda:0"  # a cloud goes where the network is
    with pytest.raises(DeviceError, match="with the cloud") as caught:
        denoiser.prepare(sheet(300))
    assert caught.value.code == "out_of_memory"
