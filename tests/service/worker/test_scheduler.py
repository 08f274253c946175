from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import pytest

from service.worker.scheduler import OLDEST_EVERY, Scheduler


class Hall:
    """Jobs that come to work in threads of their own, one step at a time."""

    def __init__(self, scheduler: Scheduler, pool: ThreadPoolExecutor) -> None:
        self.scheduler, self.pool = scheduler, pool
        self.order: list[str] = []
        self.waited: list[str] = []
        self.at_once = self.most = 0
        self._lock = threading.Lock()

    def step(self, job: str, seconds: float = 0.0, **options: Any) -> None:
        given = {"submitted": 0, "waits": lambda: self.waited.append(job), "poll": lambda: None} | options
        with self.scheduler.work(job, **given):
            with self._lock:
                self.order.append(job)
                self.at_once += 1
                self.most = max(self.most, self.at_once)
            time.sleep(seconds)
            with self._lock:
                self.at_once -= 1

    @contextmanager
    def busy(self, **options: Any) -> Iterator[None]:
        """Hold a turn while claims gather."""
        given = {"left": 1, "submitted": 0, "waits": lambda: None, "poll": lambda: None} | options
        with self.scheduler.work("holder", **given):
            yield

    def claim(self, job: str, **options: Any) -> Any:
        before = len(self.scheduler._waiting)
        future = self.pool.submit(self.step, job, **options)
        while len(self.scheduler._waiting) == before and not future.done():
            time.sleep(0.001)
        return future


@pytest.fixture
def hall() -> Iterator[Hall]:
    with ThreadPoolExecutor(16) as pool:
        yield Hall(Scheduler(), pool)


def test_the_least_left_goes_first(hall: Hall) -> None:
    with hall.busy():
        futures = [hall.claim(job, left=left) for job, left in (("large", 900), ("small", 10), ("middle", 100))]
        assert hall.scheduler.computing == "holder"
    for future in futures:
        future.result(5)
    assert hall.order == ["small", "middle", "large"]
    assert hall.most == 1
    assert hall.scheduler.computing is None


def test_the_oldest_is_not_starved(hall: Hall) -> None:
    with hall.busy():
        futures = [hall.claim("old", left=10**6, submitted=1)]
        futures += [hall.claim(f"new {n}", left=10, submitted=2 + n) for n in range(8)]
    for future in futures:
        future.result(5)
    assert hall.order.index("old") < OLDEST_EVERY


def test_a_large_tile_gives_way_to_a_small_one(hall: Hall) -> None:
    waited: list[str] = []
    given = {"submitted": 0, "waits": lambda: waited.append("large"), "poll": lambda: None}
    with hall.scheduler.work("large", left=900, **given) as grant:
        assert not grant.yield_to_smaller()  # to nobody
        larger = hall.claim("larger", left=1000, submitted=1)
        assert not grant.yield_to_smaller()
        small = hall.claim("small", left=10, seconds=0.1, submitted=2)
        assert grant.yield_to_smaller()
        assert hall.order == ["small"]
        assert waited == ["large"]
        assert hall.scheduler.computing == "large"
        small.result(5)
    larger.result(5)
    assert hall.most == 1


def test_the_turn_of_the_oldest_is_kept(hall: Hall) -> None:
    given = {"submitted": 0, "waits": lambda: None, "poll": lambda: None}
    gave = 0
    with hall.scheduler.work("large", left=900, **given) as grant:
        for n in range(20):
            future = hall.claim(f"small {n}", left=10, submitted=n)
            if not grant.yield_to_smaller():
                assert not future.done()
                break
            gave += 1
            future.result(5)
    future.result(5)
    assert 1 <= gave <= OLDEST_EVERY


def test_nobody_gives_way_to_a_suspect_or_at_the_end(hall: Hall) -> None:
    given = {"submitted": 0, "waits": lambda: None, "poll": lambda: None}
    with hall.scheduler.work("large", left=900, **given) as grant:
        suspect = hall.claim("suspect", left=10, isolated=True)
        assert not grant.yield_to_smaller()  # it may do harm, and would not know whether it was alone
    suspect.result(5)


def test_other_work_needs_no_turn(hall: Hall) -> None:
    with hall.busy():
        hall.claim("preparing").result(5)
        hall.claim("writing").result(5)
    assert hall.waited == []


def test_a_suspect_works_alone(hall: Hall) -> None:
    with hall.busy(left=None):  # somebody prepares a cloud
        suspect = hall.claim("suspect", isolated=True, seconds=0.1)
        late = [hall.claim("late", seconds=0.1), hall.claim("tile", left=1, seconds=0.1)]
        assert hall.order == []
    for future in (suspect, *late):
        future.result(5)
    assert hall.order[0] == "suspect"
    assert set(hall.waited) == {"suspect", "late", "tile"}
    hall.most = 0
    futures = [hall.claim(f"suspect {n}", isolated=True, left=5, seconds=0.02) for n in range(3)]
    for future in futures:
        future.result(5)
    assert hall.most == 1


def test_always_alone() -> None:
    with ThreadPoolExecutor(4) as pool:
        hall = Hall(Scheduler(always_isolated=True), pool)
        with hall.busy():
            future = hall.claim("preparing")
            assert hall.order == []
        future.result(5)


def test_giving_up(hall: Hall, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.worker.scheduler.POLL_SECONDS", 0.05)

    def cancelled() -> None:
        raise KeyError

    with hall.busy():
        future = hall.claim("cancelled", left=1, poll=cancelled)
        with pytest.raises(KeyError):
            future.result(5)
        last = hall.claim("other", left=2)
    last.result(5)
    assert hall.order == ["other"]


def test_closed_nobody_begins(hall: Hall) -> None:
    polled = threading.Event()

    class PausedError(Exception):
        pass

    def park() -> None:
        polled.set()
        raise PausedError

    with hall.busy():
        future = hall.claim("next", left=1, poll=park)
        hall.scheduler.close()
        assert polled.wait(5)
    with pytest.raises(PausedError):
        future.result(5)
    with pytest.raises(PausedError):
        hall.step("late", poll=park)
    assert hall.order == []
