from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable

import numba
import pytest
import torch
from torch import Tensor

from pcdnf.models.ops.neighbours import (
    gather_max,
    gather_max_plain,
    gather_mean,
    gather_mean_plain,
    gather_points,
    knn,
    knn_plain,
    share_threads,
)


def cloud(B: int, N: int, C: int, seed: int = 0) -> Tensor:
    return torch.randn(B, N, C, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize(
    ("N", "C", "k"), [(512, 64, 16), (256, 128, 8), (512, 3, 16), (37, 3, 5), (90, 7, 33), (5, 2, 5)]
)
def test_kernels_agree_with_plain_torch(N: int, C: int, k: int) -> None:
    x = cloud(2, N, C)
    x[:, N // 2 :: 5] = x[:, :1]  # duplicates, as in a padded patch
    if C != 3:
        x += 3  # what all features share must not cost digits
    index = knn(x, k)
    assert index.dtype is torch.int32
    torch.testing.assert_close(index, knn_plain(x, k))


def test_nearest_by_exact_distances() -> None:
    x = cloud(1, 200, 64) + 10
    exact = torch.cdist(x.double(), x.double())[0].argsort(1)[:, :16]
    torch.testing.assert_close(knn(x, 16)[0].long(), exact)


def test_a_point_is_its_own_first_neighbour_even_among_duplicates() -> None:
    x = torch.zeros(1, 20, 3)
    assert knn(x, 4)[0, 7].tolist() == [7, 0, 1, 2]


@pytest.mark.parametrize("C", [3, 16])
def test_small_graph_is_the_prefix_of_the_large_one(C: int) -> None:
    x = cloud(2, 128, C).round(decimals=1)
    assert torch.equal(knn(x, 8), knn(x, 16)[..., :8])


@pytest.mark.parametrize("C", [3, 16])
def test_queries_are_rows_of_the_whole_graph(C: int) -> None:
    x = cloud(2, 100, C)
    queries = torch.randint(100, (2, 33))
    whole = knn(x, 10)
    rows = whole.gather(1, queries[..., None].expand(-1, -1, 10))
    assert torch.equal(knn(x, 10, queries), rows)
    assert torch.equal(knn_plain(x, 10, queries), rows)


@pytest.mark.parametrize("form", [knn, knn_plain])
@pytest.mark.parametrize("k", [0, 11])
def test_more_neighbours_than_points(form: Callable[..., Tensor], k: int) -> None:
    with pytest.raises(ValueError, match=f"graph of {k} neighbours needs .* the patch has 10"):
        form(cloud(1, 10, 3), k)


@pytest.mark.parametrize(
    ("fast", "plain"), [(gather_max, gather_max_plain), (gather_mean, gather_mean_plain)], ids=["max", "mean"]
)
@pytest.mark.parametrize(("N", "Q", "C", "k"), [(50, 50, 16, 8), (33, 17, 5, 3), (8, 8, 1, 1)])
def test_gathers_and_their_gradients(
    fast: Callable[..., Tensor], plain: Callable[..., Tensor], N: int, Q: int, C: int, k: int
) -> None:
    index = torch.randint(N, (3, Q, k), dtype=torch.int32)
    weight = cloud(3, Q, C, seed=1)
    results = []
    for form in (fast, plain):
        values = cloud(3, N, C).requires_grad_()
        out = form(values, index)
        (out * weight).sum().backward()
        results.append((out.detach(), values.grad))
    torch.testing.assert_close(results[0], results[1])


@pytest.mark.parametrize("gather", [gather_max, gather_mean])
def test_gathers_take_strided_and_half_precision_input(gather: Callable[..., Tensor]) -> None:
    values = cloud(2, 16, 40).bfloat16().transpose(1, 2).requires_grad_()  # (2, 40, 16), not contiguous
    index = torch.randint(40, (2, 40, 9), dtype=torch.int32)
    out = gather(values, index[..., :4])
    assert out.dtype is torch.float32
    out.sum().backward()
    assert values.grad is not None
    assert values.grad.dtype is torch.bfloat16
    torch.testing.assert_close(values.grad.float().sum(), torch.tensor(2.0 * 40 * 16), rtol=0.01, atol=0)


def test_gather_points() -> None:
    values = cloud(2, 10, 3)
    out = gather_points(values, torch.tensor([[3, 3], [0, 9]]))
    assert torch.equal(out[1], values[1, [0, 9]])


def test_kernels_use_the_threads_torch_has() -> None:
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(1)
        share_threads()
        assert numba.get_num_threads() == 1
        assert torch.get_num_threads() == 1
    finally:
        torch.set_num_threads(before)
        share_threads()


def test_first_launch_of_the_kernels_leaves_the_number_of_threads_alone() -> None:
    program = (
        "import torch; torch.set_num_threads(1)\n"
        "from pcdnf.models.ops.neighbours import knn\n"
        "knn(torch.randn(1, 20, 3), 4)\n"
        "print(torch.get_num_threads())"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "1"
