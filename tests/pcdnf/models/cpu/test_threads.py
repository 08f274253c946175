from __future__ import annotations

import os
import threading
import time

import pytest
import torch

from pcdnf.models.cpu.threads import _pools, in_parallel

pytestmark = pytest.mark.usefixtures("two_threads")


def test_results_keep_the_order_of_the_jobs() -> None:
    assert in_parallel(lambda a, b: a * b, [(i, i + 1) for i in range(50)]) == [i * (i + 1) for i in range(50)]


def test_each_thread_has_torch_to_itself() -> None:
    seen = in_parallel(lambda _: (threading.current_thread().name, torch.get_num_threads()), [(i,) for i in range(8)])
    assert {threads for _, threads in seen} == {1}
    assert all(name.startswith("pcdnf") for name, _ in seen)
    assert torch.get_num_threads() == 2


def test_a_single_job_stays_on_the_callers_thread() -> None:
    assert in_parallel(lambda: threading.current_thread().name, [()]) == [threading.current_thread().name]


def test_an_error_reaches_the_caller() -> None:
    def work(i: int) -> int:
        if i == 3:
            raise ValueError("job three")
        return i

    with pytest.raises(ValueError, match="job three"):
        in_parallel(work, [(i,) for i in range(6)])


def test_threads_made_later_have_as_many_as_this_one() -> None:
    def run() -> None:
        in_parallel(lambda _: None, [(i,) for i in range(4)])
        seen.append(torch.get_num_threads())
        seen.append(len(set(in_parallel(lambda _: slowly(), [(i,) for i in range(8)]))))

    def slowly() -> str:
        time.sleep(0.02)
        return threading.current_thread().name

    seen: list[int] = []
    _pools.clear()
    run()
    later = threading.Thread(target=run)
    later.start()
    later.join()
    assert seen == [2, 2, 2, 2]


def test_pools_are_made_once_and_not_inherited_by_a_fork() -> None:
    callers = [threading.Thread(target=in_parallel, args=(abs, [(i,) for i in range(4)])) for _ in range(8)]
    _pools.clear()
    for caller in callers:
        caller.start()
    for caller in callers:
        caller.join()
    assert list(_pools) == [2]
    child = os.fork()
    if not child:
        os._exit(0 if in_parallel(abs, [(-1,), (2,)]) == [1, 2] and list(_pools) == [2] else 1)
    assert os.waitpid(child, 0)[1] == 0
