"""Retries: how long, how often, and after which errors."""

from __future__ import annotations

import random
import time
from collections.abc import Callable
from itertools import count
from typing import TypeVar

from .errors import ProblemError, UnreachableError

FIRST_CONTACT_SECONDS = 5.0
"""Time limit for a service that has never answered: a wrong address should not cost minutes."""
FIRST_PAUSE, LONGEST_PAUSE = 0.5, 30.0
"""Seconds between attempts if the service names none; doubled each time."""
TEMPORARY = frozenset({429, 502, 503, 504})

T = TypeVar("T")
Notify = Callable[[ProblemError | UnreachableError, float], None]


class Retries:
    """How long a request is repeated before its error is raised.

    Parameters
    ----------
    seconds : float
        Time limit, counted from the first attempt of each request.
    notify : callable, optional
        Called with the error and the seconds of each pause.
    """

    def __init__(self, seconds: float, notify: Notify | None = None) -> None:
        self.seconds = seconds
        self._notify = notify
        self._reached = False

    def run(self, attempt: Callable[[], T], *, also: frozenset[int] = frozenset()) -> T:
        """Return the result of ``attempt``, repeated while the service is busy or cannot be reached.

        Parameters
        ----------
        attempt : callable
            A request that is safe to repeat.
        also : set of int
            Statuses that are temporary for this request if ``Retry-After`` comes with them.

        Raises
        ------
        ProblemError, UnreachableError
            The last error, if the next attempt would exceed the time limit.
        """
        began = time.monotonic()
        for number in count():
            try:
                result = attempt()
            except UnreachableError as error:
                failure: ProblemError | UnreachableError = error
                allowed = self.seconds if self._reached else min(self.seconds, FIRST_CONTACT_SECONDS)
                pause = _backoff(number)
            except ProblemError as error:
                self._reached = True
                asked = error.retry_after
                if error.status not in TEMPORARY and (asked is None or error.status not in also):
                    raise
                failure, allowed = error, self.seconds
                pause = _backoff(number) if asked is None else max(asked, FIRST_PAUSE)
            else:
                self._reached = True
                return result
            if time.monotonic() - began + pause > allowed:
                raise failure
            if self._notify:
                self._notify(failure, pause)
            time.sleep(pause)
        raise AssertionError("count() has no end")


def _backoff(number: int) -> float:
    """Seconds before the next attempt, randomised so that many clients do not return at once."""
    return min(LONGEST_PAUSE, FIRST_PAUSE * 2.0 ** min(number, 10)) * random.uniform(0.5, 1.0)
