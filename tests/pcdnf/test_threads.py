from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest
import torch

from pcdnf.threads import in_parallel


@pytest.fixture(autouse=True)
def two_threads() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


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
