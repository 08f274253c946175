"""A stopwatch for the stages of a run: seconds of the wall and of the processor, on one thread of Python."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable
from functools import wraps
from typing import Any

import numpy as np
from numpy.typing import NDArray


class Stages:
    """Seconds of the wall and of the processor in each stage; a stage inside another one is not counted twice."""

    def __init__(self) -> None:
        self.seconds: dict[str, NDArray[np.float64]] = defaultdict(lambda: np.zeros(2))
        self._inner: list[NDArray[np.float64]] = []
        self._watched: list[tuple[Any, str, Any]] = []

    def watch(self, owner: Any, name: str, stage: str) -> None:
        """Let the calls of ``owner.name`` count for a stage, until :meth:`end`."""
        self._watched.append((owner, name, getattr(owner, name)))
        setattr(owner, name, self.timed(getattr(owner, name), stage))

    def end(self) -> None:
        """Watch nothing any more."""
        while self._watched:
            setattr(*self._watched.pop())

    def timed(self, run: Callable[..., Any], stage: str) -> Callable[..., Any]:
        """The same function, its calls counted."""

        @wraps(run)
        def counted(*args: Any, **kwargs: Any) -> Any:
            self._inner.append(np.zeros(2))
            began = now()
            try:
                return run(*args, **kwargs)
            finally:
                whole = now() - began
                self.seconds[stage] += whole - self._inner.pop()
                if self._inner:
                    self._inner[-1] += whole

        return counted


def now() -> NDArray[np.float64]:
    """Clocks of the wall and of the processor, all threads, in seconds."""
    return np.array([time.perf_counter(), time.process_time()])
