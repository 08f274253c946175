"""Chunks of work on threads of their own, each with single-threaded torch and Numba inside.

Threads that never wait for one another keep their pace on a machine that others use too: with the usual parallel
loops inside every operation, each of hundreds of operations a batch waits for whichever thread was interrupted.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import numba
import torch

from .neighbors import share_threads

Result = TypeVar("Result")

_pools: dict[int, ThreadPoolExecutor] = {}
os.register_at_fork(after_in_child=_pools.clear)


def in_parallel(work: Callable[..., Result], jobs: Sequence[tuple[Any, ...]]) -> list[Result]:
    """``[work(*job) for job in jobs]`` on as many threads as torch was given.

    Grad mode and autocast are the thread's own: ``work`` sets what it needs.
    """
    share_threads()
    threads = torch.get_num_threads()
    layer = numba.threading_layer()  # type: ignore[attr-defined]
    if threads == 1 or len(jobs) == 1 or layer == "workqueue":  # which bears no more than one caller
        return [work(*job) for job in jobs]
    if threads not in _pools:
        _pools[threads] = ThreadPoolExecutor(threads, thread_name_prefix="pcdnf")
    return list(_pools[threads].map(lambda job: _alone(work, job), jobs))


def _alone(work: Callable[..., Result], job: tuple[Any, ...]) -> Result:
    if torch.get_num_threads() != 1:
        torch.set_num_threads(1)
    share_threads()
    return work(*job)
