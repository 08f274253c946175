from __future__ import annotations

import numpy as np

from pcdnf.models.ops import gather_numba

VALUES = np.array([[[1.0, 5.0], [3.0, 5.0], [-2.0, 7.0]]], np.float32)  # (1, 3, 2)
INDEX = np.array([[[0, 1], [2, 2], [1, 0]]], np.int32)  # (1, 3, 2)
GRAD = np.array([[[1.0, 10.0], [2.0, 20.0], [4.0, 40.0]]], np.float32)


def test_gather_max() -> None:
    out = np.empty((1, 3, 2), np.float32)
    gather_numba.gather_max(VALUES, INDEX, out)
    np.testing.assert_array_equal(out[0], [[3, 5], [-2, 7], [3, 5]])


def test_gather_argmax_takes_the_first_of_equal_values() -> None:
    out, winner = np.empty((1, 3, 2), np.float32), np.empty((1, 3, 2), np.int32)
    gather_numba.gather_argmax(VALUES, INDEX, out, winner)
    np.testing.assert_array_equal(out[0], [[3, 5], [-2, 7], [3, 5]])
    np.testing.assert_array_equal(winner[0], [[1, 0], [2, 2], [1, 1]])

    grad = np.zeros_like(VALUES)
    gather_numba.gather_argmax_backward(GRAD, winner, grad)
    np.testing.assert_array_equal(grad[0], [[0, 10], [5, 40], [2, 20]])


def test_gather_mean() -> None:
    out = np.empty((1, 3, 2), np.float32)
    gather_numba.gather_mean(VALUES, INDEX, out)
    np.testing.assert_array_equal(out[0], [[2, 5], [-2, 7], [2, 5]])

    grad = np.zeros_like(VALUES)
    gather_numba.gather_mean_backward(GRAD, INDEX, grad)
    np.testing.assert_array_equal(grad[0], [[2.5, 25], [2.5, 25], [2, 20]])
