"""Triton's kernels against the plain forms: on a GPU, or anywhere by Triton's interpreter (TRITON_INTERPRET=1)."""

from __future__ import annotations

import os

import pytest
import torch

from pcdnf.models.ops import neighbours

pytest.importorskip("triton")
INTERPRETED = os.environ.get("TRITON_INTERPRET") == "1"
if not (torch.cuda.is_available() or INTERPRETED):
    pytest.skip("no GPU, and TRITON_INTERPRET is not set", allow_module_level=True)

from pcdnf.models.ops import triton as triton_kernels  # noqa: E402

DEVICE = "cpu" if INTERPRETED else "cuda"


@pytest.mark.parametrize(("channels", "k"), [(3, 16), (64, 16), (128, 8), (20, 5)])
@pytest.mark.parametrize("some", [False, True])
def test_the_same_graph(channels: int, k: int, some: bool) -> None:
    torch.manual_seed(0)
    x = torch.randn(2, 100, channels, device=DEVICE)
    x[:, 50:60] = x[:, 40:50]  # equal distances: the lower index first
    queries = torch.randint(0, 100, (2, 37), device=DEVICE) if some else None
    graph = triton_kernels.knn(x, k, queries)
    assert graph.dtype == torch.int32
    if channels == 3:
        assert torch.equal(graph, neighbours.knn_plain(x, k, queries))
    else:  # sums in another order: a last digit may decide between two
        assert (graph == neighbours.knn_plain(x, k, queries)).float().mean() > 0.99


def test_the_same_maximum_and_gradient() -> None:
    torch.manual_seed(0)
    values = torch.randn(2, 100, 48, device=DEVICE, requires_grad=True)
    graph = neighbours.knn_plain(torch.randn(2, 100, 3, device=DEVICE), 9)
    ours, plain = triton_kernels.GatherMax.apply(values, graph), neighbours.gather_max_plain(values, graph)
    assert torch.equal(ours, plain)
    change = torch.randn_like(ours)
    (a,), (b,) = (torch.autograd.grad(x, values, change) for x in (ours, plain))
    torch.testing.assert_close(a, b)
