"""The speed of this worker, as a moving average over its tiles."""

from __future__ import annotations

from ..jobs.job import Job

NEWEST_WEIGHT = 0.3


def speed_key(job: Job) -> str:
    """Return what determines the speed of a job: its model, and whether it takes the fast form of it."""
    fast = job.parameters.get("fast", False)  # jobs of older versions do not have it
    return f"{job.parameters['model']}{' fast' if fast else ''}"


class Speeds:
    """Moving averages in points per second, one for each :func:`speed_key`."""

    def __init__(self) -> None:
        self._averages: dict[str, float] = {}
        self._newest: str | None = None

    @property
    def newest(self) -> float | None:
        """The average of the tiles that are like the last one; None before the first."""
        return None if self._newest is None else self._averages[self._newest]

    def of(self, key: str) -> float | None:
        """Return the average for a key, None before its first tile."""
        return self._averages.get(key)

    def add(self, key: str, points: int, seconds: float) -> None:
        """Take a finished tile into the average."""
        speed = points / max(seconds, 1e-6)
        before = self._averages.get(key, speed)
        self._averages[key] = before + NEWEST_WEIGHT * (speed - before)
        self._newest = key
