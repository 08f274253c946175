"""The number of requests that a caller may send: a token bucket for each, in this process."""

from __future__ import annotations

import math
import threading
import time

from ..problems import Problem


class Rates:
    """A caller may send a minute's worth at once; after that requests come back evenly.

    Parameters
    ----------
    per_minute : int
        0 for no limit.
    """

    def __init__(self, per_minute: int) -> None:
        self._limit = per_minute
        self._lock = threading.Lock()
        self._buckets: dict[str, tuple[float, float]] = {}  # what is left, and when that was counted

    def take(self, owner: str) -> None:
        """Count one request of `owner`.

        Raises
        ------
        Problem
            429 where there were too many.
        """
        if not self._limit:
            return
        with self._lock:
            now = time.monotonic()
            left, counted = self._buckets.get(owner, (float(self._limit), now))
            left = min(float(self._limit), left + (now - counted) * self._limit / 60)
            self._buckets[owner] = (left - 1 if left >= 1 else left, now)
        if left < 1:
            raise Problem(
                "too_many_requests",
                f"You send more than {self._limit} requests per minute.",
                hint="Poll less often, or follow a job with GET /jobs/{id}/events.",
                headers={"Retry-After": str(math.ceil((1 - left) * 60 / self._limit))},
                limit=self._limit,
            )
