import torch

from pcdnf.models.lite import LiteConfig, PCDNFLite

GENERATOR = torch.Generator().manual_seed(0)


def patches(count: int = 4, points: int = 128) -> tuple[torch.Tensor, torch.Tensor]:
    xy = torch.rand(count, points, 2, generator=GENERATOR) * 1.4 - 0.7
    z = 0.1 * torch.randn(count, points, 1, generator=GENERATOR)
    local = torch.cat([xy, z], -1)
    local[:, 0] = 0
    normals = torch.nn.functional.normalize(torch.randn(count, points, 3, generator=GENERATOR), dim=-1)
    return local, normals


def network() -> PCDNFLite:
    torch.manual_seed(0)
    return PCDNFLite().eval()


def test_size_and_shapes() -> None:
    net = network()
    assert 40_000 < sum(p.numel() for p in net.parameters()) < 50_000
    output = net(*patches())
    assert output.displacement.shape == (4, 3)
    assert torch.allclose(output.normal.norm(dim=-1), torch.ones(4))
    assert (output.normal[:, 2] > 0).all()
    assert output.weight.shape == (4, 128)
    assert output.selected.shape == (4, 64)
    kept = output.weight.gather(1, output.selected)
    assert (kept.min(1).values >= output.weight.median(1).values).all()


def test_untrained_it_is_a_least_squares_fit() -> None:
    points, normals = patches(1, 2000)
    points[..., 2] += 0.2
    points[:, 0] = 0
    output = network()(points, normals)
    assert abs(output.displacement[0, 2] - 0.2) < 0.02


def test_padding_has_no_weight_and_no_influence() -> None:
    points, normals = patches(1, 60)
    padded = torch.cat([points, torch.zeros(1, 68, 3)], 1)
    filled = torch.cat([normals, normals[:, :1].expand(1, 68, 3)], 1)
    short, long = network()(points, normals), network()(padded, filled)
    assert torch.allclose(short.displacement, long.displacement, atol=1e-5)
    assert torch.equal(long.weight[:, 60:], torch.zeros(1, 68))


def test_order_of_the_neighbours_does_not_matter() -> None:
    points, normals = patches(2)
    order = torch.cat([torch.zeros(1, dtype=torch.long), 1 + torch.randperm(127, generator=GENERATOR)])
    one, other = network()(points, normals), network()(points[:, order], normals[:, order])
    assert torch.allclose(one.displacement, other.displacement, atol=1e-5)
    assert torch.allclose(one.weight[:, order], other.weight, atol=1e-5)


def test_width_is_configuration() -> None:
    small = PCDNFLite(LiteConfig(width=16))
    assert sum(p.numel() for p in small.parameters()) < 5000
    assert small(*patches()).normal.shape == (4, 3)
