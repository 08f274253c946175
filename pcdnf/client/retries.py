"""Trying again: how long, how often, and what for."""

from __future__ import annotations

import random
import time
from collections.abc import Callable
from itertools import count
from typing import TypeVar

from .errors import ProblemError, UnreachableError

FIRST_CONTACT_SECONDS = 5.0
"""A service that never answered is given up after this; a wrong address should not cost minutes."""
FIRST_PAUSE, LONGEST_PAUSE = 0.5, 30.0
"""Seconds between attempts where the service names none; doubled each time."""
TEMPORARY = frozenset({429, 502, 503, 504})

T = TypeVar("T")
Notify = Callable[[ProblemError | UnreachableError, float], None]


class Retries:
    """How long a request is repeated before its error is raised.

    Parameters
    ----------
    seconds : float
        Counted from the first attempt of each request.
    notify : callable, optional
        Told the error and the seconds of each pause.
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
            Must be safe to repeat.
        also : set of int
            Statuses that are temporary for this request when they come with a ``Retry-After``.

        Raises
        ------
        ProblemError, UnreachableError
            The last error, once the next attempt would come too late.
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
    """Seconds before the attempt after this one; scattered, so that many clients do not come back at once."""
    return min(LONGEST_PAUSE, FIRST_PAUSE * 2.0 ** min(number, 10)) * random.uniform(0.5, 1.0)
