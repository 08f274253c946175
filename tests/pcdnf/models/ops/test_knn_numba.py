"""The selection kernels by themselves; ``test_neighbours.py`` holds them to the plain form."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from pcdnf.models.cpu.folded_layers import as_numpy
from pcdnf.models.ops.knn_numba import GROUPS, MOST, NETWORK, select_coordinates, select_features


def test_network_sorts_every_pattern_of_zeros_and_ones() -> None:
    rng = np.random.default_rng(0)
    values = (rng.random((20_000, GROUPS)) < rng.random((20_000, 1))).astype(np.float32)
    for i, j in NETWORK:
        low, high = np.minimum(values[:, i], values[:, j]), np.maximum(values[:, i], values[:, j])
        values[:, i], values[:, j] = low, high
    assert (np.diff(values) >= 0).all()


def order(keys: np.ndarray, k: int) -> np.ndarray:
    """The k smallest of keys (Q, N), the diagonal first, of equal ones the lower index first."""
    keys = keys.copy()
    np.fill_diagonal(keys, -np.inf)
    return np.argsort(keys, axis=1, kind="stable")[:, :k]


@pytest.mark.parametrize(("N", "k"), [(512, 16), (256, 8), (100, 10), (33, 1), (31, 31), (40, MOST), (7, 7), (1, 1)])
def test_features(N: int, k: int) -> None:
    x = np.random.default_rng(N).normal(size=(N, 20)).astype(np.float32)
    gram = x @ x.T
    squares = gram.diagonal().copy()
    index = np.full((1, N, k), -1, np.int32)
    select_features(gram[None], squares[None], np.arange(N, dtype=np.int32)[None], index)
    np.testing.assert_array_equal(index[0], order(squares - 2 * gram, k))


def test_features_in_bfloat16_with_their_ties() -> None:
    x = torch.randn(1, 512, 20, generator=torch.Generator().manual_seed(0)).bfloat16()
    gram = x @ x.transpose(1, 2)
    squares = x.float().square().sum(-1)
    index = np.full((1, 512, 16), -1, np.int32)
    select_features(as_numpy(gram), squares.numpy(), np.arange(512, dtype=np.int32)[None], index)
    np.testing.assert_array_equal(index[0], order((squares - 2 * gram[0].float()).numpy(), 16))


@pytest.mark.parametrize(("N", "k"), [(512, 16), (100, 10), (65, 3), (7, 7)])
def test_coordinates_with_many_ties(N: int, k: int) -> None:
    x = np.random.default_rng(N).integers(0, 4, size=(N, 3)).astype(np.float32)
    index = np.full((1, N, k), -1, np.int32)
    select_coordinates(x[None], np.arange(N, dtype=np.int32)[None], index)
    keys = ((x[:, None] - x[None]) ** 2).sum(-1)
    np.testing.assert_array_equal(index[0], order(keys, k))


def test_points_that_are_all_the_same() -> None:
    index = np.full((1, 300, 16), -1, np.int32)
    select_coordinates(np.zeros((1, 300, 3), np.float32), np.arange(300, dtype=np.int32)[None], index)
    np.testing.assert_array_equal(index[0, 200], [200, *range(15)])


def test_not_a_number_gives_valid_indices() -> None:
    points = np.full((1, 64, 3), np.nan, np.float32)
    index = np.full((1, 64, 8), -1, np.int32)
    select_coordinates(points, np.arange(64, dtype=np.int32)[None], index)
    np.testing.assert_array_equal(index[0], np.arange(64)[:, None].repeat(8, 1))
