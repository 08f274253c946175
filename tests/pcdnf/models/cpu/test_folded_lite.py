import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from pcdnf.models.build import build_network
from pcdnf.models.checkpoint import load_checkpoint
from pcdnf.models.cpu.folded_lite import CHUNK, FoldedLite
from pcdnf.models.lite import LiteConfig, PCDNFLite


def patches(count: int, points: int = 96, padding: int = 0) -> tuple[Tensor, Tensor]:
    """Noisy pieces of curved surfaces, the last ``padding`` entries of every other one at the origin."""
    generator = torch.Generator().manual_seed(count)
    local = torch.randn(count, points, 3, generator=generator) * torch.tensor([0.4, 0.4, 0.05])
    local[..., 2] += 0.2 * local[..., 0].square() + 0.05
    local[:, 0] = 0
    normals = F.normalize(torch.randn(count, points, 3, generator=generator) + torch.tensor([0.0, 0.0, 2.0]), dim=-1)
    if padding:
        local[::2, -padding:], normals[::2, -padding:] = 0, normals[::2, :1]
    return local, normals


def shipped() -> PCDNFLite:
    info, state = load_checkpoint("pcdnf-lite")
    network = build_network(info.kind, info.config)
    network.load_state_dict(state)
    assert isinstance(network, PCDNFLite)
    return network.eval()


def untrained(width: int) -> PCDNFLite:
    torch.manual_seed(0)
    network = PCDNFLite(LiteConfig(width=width)).eval()
    for parameter in network.parameters():
        torch.nn.init.normal_(parameter, std=0.3)
    return network


@pytest.mark.parametrize("network", [shipped(), untrained(64), untrained(24)], ids=["shipped", "wild", "narrow"])
@pytest.mark.parametrize(("count", "points", "padding"), [(1, 1, 0), (3, 97, 40), (CHUNK + 1, 96, 90)])
def test_equals_the_network(network: PCDNFLite, count: int, points: int, padding: int) -> None:
    given = patches(count, points, padding)
    with torch.no_grad():
        expected = network(*given)
    output = FoldedLite(network)(*given)
    for name in ("displacement", "normal", "weight"):
        assert (getattr(output, name) - getattr(expected, name)).abs().max() < 1e-5 * (1 + expected.weight.max())
    assert torch.equal(output.weight == 0, expected.weight == 0)


def test_bfloat16_is_nearer_than_autocast() -> None:
    network = shipped()
    given = patches(200)
    with torch.inference_mode():
        expected = network(*given)
        with torch.autocast("cpu", torch.bfloat16):
            rounded = network(*given)
    output = FoldedLite(network, torch.bfloat16)(*given)
    for name, bound in (("displacement", 3e-3), ("normal", 2e-2)):
        error, usual = ((getattr(other, name) - getattr(expected, name)).abs() for other in (output, rounded))
        assert error.max() < bound
        assert error.mean() < usual.mean()


def test_a_patch_does_not_depend_on_the_others_of_its_batch() -> None:
    folded = FoldedLite(shipped(), torch.bfloat16)
    points, normals = patches(2 * CHUNK)
    output, turned = folded(points, normals), folded(points.roll(5, 0), normals.roll(5, 0))
    assert torch.equal(output.displacement.roll(5, 0), turned.displacement)
    assert torch.equal(output.normal.roll(5, 0), turned.normal)


def test_keeps_the_weights_it_was_made_with() -> None:
    network = untrained(16)
    folded, given = FoldedLite(network), patches(2)
    before = folded(*given).displacement
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.zero_()
    assert torch.equal(folded(*given).displacement, before)


def test_other_types_are_refused() -> None:
    with pytest.raises(ValueError, match="float32 or bfloat16"):
        FoldedLite(untrained(16), torch.float16)
