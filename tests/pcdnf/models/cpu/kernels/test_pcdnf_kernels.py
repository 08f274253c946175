"""The fused kernels against the same in torch, in float32 and in bfloat16."""

from __future__ import annotations

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from pcdnf.models.cpu.folded_layers import as_numpy
from pcdnf.models.cpu.kernels import pcdnf as pcdnf_kernels
from pcdnf.models.ops.neighbours import gather_max_plain, gather_mean_plain, gather_points

TOLERANCE = {torch.float32: {"rtol": 1e-5, "atol": 1e-6}, torch.bfloat16: {"rtol": 1e-2, "atol": 1e-3}}
both = pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])


def noise(*shape: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(len(shape)))


@both
@pytest.mark.parametrize("k", [1, 6, 16])
def test_edge_conv(dtype: torch.dtype, k: int) -> None:
    N, C = 70, 24
    projected = noise(2, N, 2 * C + 3).to(dtype)
    graph = torch.randint(N, (2, N, 16), dtype=torch.int32)
    scale = torch.linspace(-1, 2, C)
    out = torch.full((2, N, C + 5), 7.0, dtype=dtype)
    pcdnf_kernels.edge_conv(as_numpy(projected), 3, 3 + C, graph.numpy(), k, scale.numpy(), 0.2, as_numpy(out), 5)
    best = gather_max_plain(projected[..., 3 : 3 + C], graph[..., :k])
    expected = F.leaky_relu(projected[..., 3 + C :].float() + scale * best, 0.2)
    torch.testing.assert_close(out[..., 5:].float(), expected, **TOLERANCE[dtype])
    assert (out[..., :5] == 7).all()


@both
def test_bfloat16_rounds_to_the_nearest_even(dtype: torch.dtype) -> None:
    values = torch.cat([noise(1, 1, 1000), torch.tensor([[[1 + 2**-8, 1 + 3 * 2**-8, 0.0, -0.0]]])], -1)
    features = torch.zeros(1, 1, values.shape[2], dtype=dtype)
    out = torch.empty_like(features)
    index = torch.zeros(1, 1, 1, dtype=torch.int32)
    near = torch.zeros(1, 1, 2 * values.shape[2])
    near[..., : values.shape[2]] = values
    pcdnf_kernels.edge_conv(
        as_numpy(near), values.shape[2], 0, index.numpy(), 1, torch.ones(values.shape[2]).numpy(), 1.0, as_numpy(out), 0
    )
    assert torch.equal(out, values.to(dtype))


@both
def test_guide(dtype: torch.dtype) -> None:
    M = 45
    points, normals = noise(2, M, 3), F.normalize(noise(2, M, 3) + 1, dim=-1)
    hidden = [F.relu(noise(2, M, 128) + i).to(dtype) for i in range(2)]
    last = [(noise(3, 64) / 8, noise(3)) for _ in range(2)]
    angle, distance = noise(2, 32), noise(2, 32) + 0.5
    refined = torch.empty_like(points), torch.empty_like(points)
    out = torch.empty(2, M, 192, dtype=dtype)
    pcdnf_kernels.guide(
        *(as_numpy(x) for x in (points, normals, *hidden)),
        *(x.numpy() for layer in last for x in layer),
        *(x.numpy() for x in (angle, distance, *refined)),
        as_numpy(out),
    )
    p, n = (
        x + F.linear(h[..., :64].float(), weight, bias)
        for x, h, (weight, bias) in zip((points, normals), hidden, last, strict=True)
    )
    torch.testing.assert_close(refined, (p, n), rtol=1e-5, atol=1e-5)
    theta = torch.atan2(torch.linalg.cross(p, n, dim=-1).norm(dim=-1), (p * n).sum(-1))[..., None]
    near = torch.exp(-p.square().sum(-1))[..., None]
    expected = [hidden[0][..., 64:].float(), hidden[1][..., 64:].float()]
    expected += [F.relu(angle[0] * theta + angle[1]), F.relu(distance[0] * near + distance[1])]
    torch.testing.assert_close(
        out.float(), torch.cat(expected, -1), rtol=1e-2 if dtype is torch.bfloat16 else 1e-4, atol=1e-4
    )


@both
def test_score(dtype: torch.dtype) -> None:
    channels = (noise(3, 50, 37) * 0.1 - 0.15).to(dtype)
    weight, selected = torch.empty(3, 50), torch.empty(3, 20, dtype=torch.int32)
    pcdnf_kernels.score(as_numpy(channels), 0.2, weight.numpy(), selected.numpy())
    expected = torch.sigmoid(F.leaky_relu(channels.float().amax(-1), 0.2))
    torch.testing.assert_close(weight, expected)
    kept = weight.gather(1, selected.long()).sort(descending=True).values
    torch.testing.assert_close(kept, expected.topk(20).values)
    assert (selected.diff() > 0).all()


def test_score_takes_the_lower_index_of_equal_weights() -> None:
    channels = torch.tensor([0.0, 3.0, 1.0, 1.0, 1.0, 2.0])[None, :, None]
    weight, selected = torch.empty(1, 6), torch.empty(1, 4, dtype=torch.int32)
    pcdnf_kernels.score(channels.numpy(), 0.2, weight.numpy(), selected.numpy())
    assert selected.tolist() == [[1, 2, 3, 5]]


@both
def test_augment(dtype: torch.dtype) -> None:
    own, near, weight = noise(2, 40, 12).to(dtype), (noise(2, 40, 12) + 1).to(dtype), noise(2, 40).abs()
    selected, graph = torch.randint(40, (2, 35), dtype=torch.int32), torch.randint(40, (2, 35, 10), dtype=torch.int32)
    out = torch.empty(2, 35, 12, dtype=dtype)
    pcdnf_kernels.augment(as_numpy(own), as_numpy(near), *(x.numpy() for x in (weight, selected, graph)), as_numpy(out))
    expected = gather_points(own.float(), selected) + gather_mean_plain(weight[..., None] * near.float(), graph)
    torch.testing.assert_close(out.float(), expected, **TOLERANCE[dtype])


@both
@pytest.mark.parametrize(("N", "C"), [(64, 300), (7, 5), (1, 128)])
def test_pool_and_centre(dtype: torch.dtype, N: int, C: int) -> None:
    x = noise(2, N, C).to(dtype)
    pooled, centred, squares = torch.empty(2, C), torch.empty(2, N, C, dtype=dtype), torch.empty(2, N)
    pcdnf_kernels.pool(as_numpy(x), pooled.numpy())
    pcdnf_kernels.centre(as_numpy(x), as_numpy(centred), squares.numpy())
    assert torch.equal(pooled, x.float().amax(1))
    expected = x.float() - x.float().mean(1, keepdim=True)
    torch.testing.assert_close(centred.float(), expected, rtol=1e-4 if dtype is torch.float32 else 4e-3, atol=1e-5)
    torch.testing.assert_close(squares, centred.float().square().sum(-1), rtol=1e-4, atol=1e-5)
