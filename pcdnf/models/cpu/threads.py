"""Chunks of work on separate threads, each with single-threaded torch and Numba.

Threads that do not wait for each other stay fast on a machine that runs other programs too. With parallel loops inside
every operation, each of the hundreds of operations per batch would wait for the thread that was interrupted.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import numba
import torch

from ..ops.neighbours import share_threads

Result = TypeVar("Result")

_pools: dict[int, ThreadPoolExecutor] = {}
_lock = threading.Lock()
os.register_at_fork(before=_lock.acquire, after_in_parent=_lock.release, after_in_child=lambda: _forget())


def in_parallel(work: Callable[..., Result], jobs: Sequence[tuple[Any, ...]]) -> list[Result]:
    """``[work(*job) for job in jobs]`` on as many threads as torch was given.

    Grad mode and autocast are the thread's own: ``work`` sets what it needs.
    """
    share_threads()
    threads = torch.get_num_threads()
    layer = numba.threading_layer()  # type: ignore[attr-defined]
    if threads == 1 or len(jobs) == 1 or layer == "workqueue":  # which bears no more than one caller
        return [work(*job) for job in jobs]
    return list(_pool(threads).map(lambda job: work(*job), jobs))


def _pool(threads: int) -> ThreadPoolExecutor:
    with _lock:
        if threads not in _pools:
            ready = threading.Barrier(threads + 1)
            _pools[threads] = pool = ThreadPoolExecutor(threads, "pcdnf", _alone, (ready,))
            for _ in range(threads):
                pool.submit(int)
            ready.wait()
            torch.set_num_threads(threads)  # what was last set anywhere is what new threads begin with
        return _pools[threads]


def _alone(ready: threading.Barrier) -> None:
    torch.set_num_threads(1)
    share_threads()
    ready.wait()


def _forget() -> None:
    _pools.clear()
    _lock.release()
