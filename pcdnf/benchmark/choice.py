"""A peer whose parameter is chosen by the truth: in its favour, since nobody who uses it knows the truth."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..errors import PcdnfError
from .methods import Group, Method, Output

Error = Callable[[Output], float]
"""What is to be smallest."""


@dataclass(frozen=True)
class Choice:
    """The best of several methods on each cloud.

    Attributes
    ----------
    name : str
    candidates : tuple of Method
        A small grid of one method's parameter.
    group : Group
    """

    name: str
    candidates: tuple[Method, ...]
    group: Group = "peer"

    @property
    def identity(self) -> dict[str, str]:
        """All that the result depends on besides the input and its truth."""
        return {"method": self.name, "candidates": json.dumps([one.identity for one in self.candidates])}

    def run(self, points: NDArray[np.float64], level: float, error: Error) -> tuple[Output, float]:
        """Return the candidate's output that has the least error, with its name among the facts, and its seconds alone.

        Raises
        ------
        PcdnfError
            What the last candidate raised, where all of them failed.
        """
        best: tuple[float, Output, float] | None = None
        failure: PcdnfError | None = None
        for candidate in self.candidates:
            began = time.perf_counter()
            try:
                output = candidate.run(points, level)
            except PcdnfError as problem:
                failure = problem
                continue
            seconds, value = time.perf_counter() - began, error(output)
            if best is None or value < best[0]:
                facts = output.facts | {"chosen": candidate.name, "of": len(self.candidates)}
                best = value, replace(output, facts=facts), seconds
        if best is None:
            assert failure is not None
            raise failure
        return best[1], best[2]


def run_timed(method: Method | Choice, points: NDArray[np.float64], level: float, error: Error) -> tuple[Output, float]:
    """Return what a method makes of a cloud, and its seconds; ``error`` decides between the candidates of a choice."""
    if isinstance(method, Choice):
        return method.run(points, level, error)
    began = time.perf_counter()
    output = method.run(points, level)
    return output, time.perf_counter() - began
