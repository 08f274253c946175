from __future__ import annotations

from dataclasses import replace

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from benchmarks.reference import random_release
from pcdnf.models.authors_weights import CONFIG, convert_release
from pcdnf.models.config import NetworkConfig
from pcdnf.models.cpu import folded_layers as layers
from pcdnf.models.cpu.folded import CHUNK, FoldedPCDNF, PlainInference, fold
from pcdnf.models.layers import ChannelNorm
from pcdnf.models.pcdnf import PCDNF


def patches(B: int, M: int = 512) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(B)
    points = torch.randn(B, M, 3, generator=generator) * torch.tensor([0.5, 0.5, 0.1])
    return points, F.normalize(torch.randn(B, M, 3, generator=generator) + torch.tensor([0.0, 0.0, 2.0]), dim=-1)


def trained(config: NetworkConfig) -> PCDNF:
    """A network with lived-in weights; some BatchNorm scales are negative."""
    torch.manual_seed(0)
    network = PCDNF(config).eval()
    network.load_state_dict(convert_release(random_release()), strict=not config.anchor)
    for module in network.modules():
        if isinstance(module, ChannelNorm):
            nn.init.normal_(module.weight[::7], mean=-0.5, std=0.1)
    return network


@pytest.mark.parametrize(
    "config", [NetworkConfig(), NetworkConfig(anchor=True), CONFIG], ids=["plain", "anchor", "release"]
)
@pytest.mark.parametrize("B", [1, 3, CHUNK + 1])
def test_equals_the_network(config: NetworkConfig, B: int) -> None:
    network = trained(config)
    points, normals = patches(B)
    with torch.no_grad():
        expected = network(points, normals)
    output = fold(network)(points, normals)
    assert type(output) is type(expected)
    for name in ("displacement", "normal", "weight", "refined_points", "refined_normals"):
        error = (getattr(output, name) - getattr(expected, name)).abs()
        # Two neighbours as far as one another to the last digit may change places, and move a result by more.
        assert (error > 1e-4).float().mean() < 0.1
        assert error.max() < 1e-2
        assert error.median() < 2e-6
    assert torch.equal(output.selected, expected.selected.sort().values)


def test_other_patch_sizes() -> None:
    config = NetworkConfig(patch_points=150, selected=77, anchor=True)
    network = trained(config)
    points, normals = patches(2, 150)
    with torch.no_grad():
        expected = network(points, normals)
    output = fold(network)(points, normals)
    torch.testing.assert_close(output.displacement, expected.displacement, rtol=0, atol=1e-4)
    torch.testing.assert_close(output.normal, expected.normal, rtol=0, atol=1e-4)


def test_bfloat16_is_close() -> None:
    network = trained(NetworkConfig(anchor=True))
    points, normals = patches(4)
    exact, rough = fold(network)(points, normals), fold(network, torch.bfloat16)(points, normals)
    assert all(x.dtype is torch.float32 for x in rough if x.is_floating_point())
    assert (exact.displacement - rough.displacement).norm(dim=-1).mean() < 0.02
    cosine = F.cosine_similarity(exact.normal, rough.normal)
    assert (cosine > 0.99).all()
    assert (exact.weight - rough.weight).abs().max() < 0.05


@pytest.mark.usefixtures("two_threads")
def test_batch_and_threads_change_nothing() -> None:
    folded = fold(trained(NetworkConfig(anchor=True)))
    points, normals = patches(2 * CHUNK + 3)
    together = folded(points, normals)
    torch.set_num_threads(1)
    again = folded(points, normals)
    assert all(torch.equal(a, b) for a, b in zip(together, again, strict=True))
    for i in (0, CHUNK, 2 * CHUNK + 2):
        alone = folded(points[i : i + 1], normals[i : i + 1])
        torch.testing.assert_close(together.displacement[i], alone.displacement[0], rtol=0, atol=1e-5)
        torch.testing.assert_close(together.normal[i], alone.normal[0], rtol=0, atol=1e-5)


def test_without_onednn(monkeypatch: pytest.MonkeyPatch) -> None:
    network = trained(NetworkConfig())
    points, normals = patches(2)
    expected = fold(network)(points, normals)
    monkeypatch.setattr(layers, "has_packed_products", lambda _: False)
    torch.testing.assert_close(fold(network)(points, normals).displacement, expected.displacement, rtol=0, atol=1e-5)


def test_the_network_itself_stays_as_it_was() -> None:
    network = trained(NetworkConfig()).train()
    state = {name: tensor.clone() for name, tensor in network.state_dict().items()}
    points, normals = patches(2)
    output = fold(network)(points, normals)
    assert not output.displacement.requires_grad
    assert network.training
    assert all(parameter.requires_grad for parameter in network.parameters())
    assert all(torch.equal(tensor, state[name]) for name, tensor in network.state_dict().items())


def test_ablations_run_as_they_are() -> None:
    config = NetworkConfig(patch_points=64, selected=32, refinement=False)
    network = PCDNF(config)
    folded = fold(network)
    assert isinstance(folded, PlainInference)
    assert isinstance(fold(PCDNF(replace(config, refinement=True))), FoldedPCDNF)
    points, normals = patches(2, 64)
    with torch.no_grad():
        expected = network.eval()(points, normals)
    assert torch.equal(folded(points, normals).displacement, expected.displacement)


def test_other_precisions() -> None:
    with pytest.raises(ValueError, match=r"Fold to float32 or bfloat16; torch\.float16 has no kernels"):
        fold(PCDNF(), torch.float16)


def test_a_torch_without_the_private_products_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise RuntimeError("bf16 path needs the cpu support")

    monkeypatch.setattr(layers, "_linear", refuse)
    layers.has_packed_products.cache_clear()
    try:
        assert not layers.has_packed_products(torch.float32)
        product = layers.Affine(torch.eye(4), torch.ones(4), torch.float32, slope=0.5)(torch.tensor([[1.0, -3, 0, 2]]))
    finally:
        layers.has_packed_products.cache_clear()
    assert product.tolist() == [[2.0, -1.0, 1.0, 3.0]]
