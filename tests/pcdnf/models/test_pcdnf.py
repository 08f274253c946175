from __future__ import annotations

from dataclasses import asdict, replace

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from pcdnf.models.anchor import ANCHOR_FLOOR, ANCHOR_RIDGE
from pcdnf.models.config import NetworkConfig
from pcdnf.models.layers import EdgeConv
from pcdnf.models.ops.neighbours import knn
from pcdnf.models.pcdnf import PCDNF
from pcdnf.models.quadric import fit_quadric

SMALL = NetworkConfig(patch_points=96, selected=48)
ABLATIONS = {
    "V1": {"selector": False, "refinement": False},
    "V2": {"refinement": False},
    "V3": {"normal_branch": False},
    "V4": {"point_branch": False},
}


def patches(B: int = 3, M: int = 96, seed: int = 0) -> tuple[Tensor, Tensor]:
    """Noisy, slightly bent sheets, centre first."""
    generator = torch.Generator().manual_seed(seed)
    points = torch.randn(B, M, 3, generator=generator) * torch.tensor([0.4, 0.4, 0.05])
    points[..., 2] += 0.2 * points[..., 0] ** 2 + 0.1
    points[:, 0] = 0
    normals = F.normalize(torch.randn(B, M, 3, generator=generator) * 0.2 + torch.tensor([0.0, 0.0, 1.0]), dim=-1)
    return points, normals


def network(config: NetworkConfig = SMALL, seed: int = 0) -> PCDNF:
    torch.manual_seed(seed)
    return PCDNF(config)


def parameters(config: NetworkConfig) -> int:
    return sum(parameter.numel() for parameter in PCDNF(config).parameters())


def test_size_is_the_papers() -> None:
    assert parameters(NetworkConfig()) == 619_276


def test_output() -> None:
    net = network().eval()
    points, normals = patches()
    with torch.no_grad():
        output = net(points, normals)
    assert [tuple(x.shape) for x in output] == [(3, 3), (3, 3), (3, 96), (3, 48), (3, 96, 3), (3, 96, 3)]
    assert output.displacement.abs().max() < 1
    assert ((output.weight > 0) & (output.weight < 1)).all()
    kept = output.weight.gather(1, output.selected)
    dropped = output.weight.scatter(1, output.selected, -1.0).amax(1)
    assert (kept.amin(1) >= dropped).all()


def test_edge_conv_is_the_edge_building_one_for_positive_scales() -> None:
    torch.manual_seed(0)
    conv = EdgeConv(6, 10).eval()
    conv.norm.running_mean.normal_()
    conv.norm.running_var.uniform_(0.5, 2)
    torch.nn.init.uniform_(conv.norm.weight, 0.1, 2)
    x = torch.randn(2, 40, 6)
    graph = knn(x, 7)
    near = torch.stack([x[b][graph[b].long()] for b in range(2)])  # (2, 40, 7, 6)
    own = x[:, :, None].expand_as(near)
    weight = torch.cat([conv.neighbour.weight, conv.centre.weight + conv.neighbour.weight], 1)  # [W1, W2]
    edges = F.linear(torch.cat([near - own, own], -1), weight)
    expected = F.leaky_relu(conv.norm(edges), 0.2).amax(2)
    torch.testing.assert_close(conv(x, graph), expected)


def test_permutation_of_the_points_changes_nothing() -> None:
    net = network().eval()
    points, normals = patches()
    order = torch.randperm(96, generator=torch.Generator().manual_seed(1))
    with torch.no_grad():
        a, b = net(points, normals), net(points[:, order], normals[:, order])
    torch.testing.assert_close(a.displacement, b.displacement, rtol=0, atol=1e-5)
    torch.testing.assert_close(a.normal, b.normal, rtol=0, atol=1e-5)
    torch.testing.assert_close(a.weight[:, order], b.weight, rtol=0, atol=1e-5)


@pytest.mark.parametrize("anchor", [False, True])
def test_a_patch_does_not_see_its_batch(anchor: bool) -> None:
    net = network(replace(SMALL, anchor=anchor)).eval()
    points, normals = patches(5)
    with torch.no_grad():
        together = net(points, normals)
        alone = [net(points[i : i + 1], normals[i : i + 1]) for i in range(5)]
    for name in ("displacement", "normal", "weight"):
        single = torch.cat([getattr(output, name) for output in alone])
        torch.testing.assert_close(getattr(together, name), single, rtol=0, atol=1e-5)


@pytest.mark.parametrize("anchor", [False, True])
def test_every_parameter_learns_under_bfloat16_autocast(anchor: bool) -> None:
    net = network(replace(SMALL, anchor=anchor))
    with torch.autocast("cpu", torch.bfloat16):
        output = net(*patches())
        loss = sum(x.square().sum() for x in output if x.is_floating_point())
    assert all(x.dtype is torch.float32 for x in output if x.is_floating_point())
    loss.backward()
    silent = [name for name, p in net.named_parameters() if p.grad is None or not p.grad.isfinite().all()]
    assert silent == []


def test_bfloat16_is_close_to_float32() -> None:
    net = network().eval()
    points, normals = patches()
    with torch.no_grad():
        a = net(points, normals)
        with torch.autocast("cpu", torch.bfloat16):
            b = net(points, normals)
    torch.testing.assert_close(a.displacement, b.displacement, rtol=0, atol=0.02)
    torch.testing.assert_close(a.weight, b.weight, rtol=0, atol=0.02)


def test_a_fresh_anchored_network_is_the_fit() -> None:
    net = network(replace(SMALL, anchor=True)).eval()
    points, normals = patches()
    with torch.no_grad():
        output = net(points, normals)
        fit = fit_quadric(points, output.weight + ANCHOR_FLOOR, ridge=torch.tensor(ANCHOR_RIDGE))
    torch.testing.assert_close(output.displacement, fit.displacement(), rtol=0, atol=0.02)
    torch.testing.assert_close(output.normal, fit.normal(), rtol=0, atol=0.05)


def test_the_anchor_takes_the_loss_to_the_selector() -> None:
    net = network(replace(SMALL, anchor=True)).eval()
    output = net(*patches())
    output.weight.retain_grad()
    output.displacement.square().sum().backward()
    assert (output.weight.grad.abs().sum(1) > 0).all()
    assert net.selector.score.linear.weight.grad.abs().max() > 0


@pytest.mark.parametrize("name", ABLATIONS)
@pytest.mark.parametrize("anchor", [False, True])
def test_ablations_train_and_infer(name: str, anchor: bool) -> None:
    config = replace(SMALL, anchor=anchor, **ABLATIONS[name])
    net = network(config)
    points, normals = patches()
    output = net(points, normals)
    (output.displacement.square().sum() + output.normal.square().sum() + output.weight.sum()).backward()
    assert any(parameter.grad is not None for parameter in net.parameters())
    with torch.no_grad():
        output = net.eval()(points, normals)
    assert output.displacement.shape == output.normal.shape == (3, 3)
    assert output.selected.shape == (3, 96 if name == "V1" else 48)
    if name == "V1":
        assert (output.weight == 1).all()
    if name == "V3" and not anchor:
        assert torch.equal(output.normal, normals[:, 0])
        assert torch.equal(output.refined_normals, normals)
    if name == "V4" and not anchor:
        assert (output.displacement == 0).all()
        assert torch.equal(output.refined_points, points)


def test_ablations_lack_what_they_switch_off() -> None:
    full = NetworkConfig()
    size = {name: parameters(replace(full, **flags)) for name, flags in ABLATIONS.items()}
    net = PCDNF(full)
    count = {name: sum(p.numel() for p in module.parameters()) for name, module in net.named_children()}
    # Without refinement the decoders see 128 channels instead of 256 and the patch's 128.
    narrower = 128 * 512 + 128 * 512 + 128 * 128
    assert size["V2"] == parameters(full) - count["refinement"] - narrower
    assert size["V1"] == size["V2"] - count["selector"]
    assert size["V3"] < parameters(full) - count["normal_extractor"]
    assert size["V4"] < parameters(full) - count["point_extractor"]


def test_configuration_is_plain_data() -> None:
    config = NetworkConfig(anchor=True, selected=100)
    assert NetworkConfig(**asdict(config)) == config


def test_configurations_that_make_no_network() -> None:
    with pytest.raises(ValueError, match="at least one of point_branch and normal_branch"):
        NetworkConfig(point_branch=False, normal_branch=False)
    with pytest.raises(ValueError, match="k1 = 20 must not exceed k2 = 16"):
        NetworkConfig(k1=20)
