"""Queues by size. A job waits only behind jobs of about its own size.

A worker takes jobs from every lane, so it has a few small jobs, one medium job and one large job in flight at a time.
:mod:`service.worker.scheduler` divides the device between them. The two widest lanes bound the memory.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Lane:
    """One queue of the engine.

    Attributes
    ----------
    queue : str
    above, upto : int
        Which jobs, by points times iterations.
    concurrency : int
        Jobs that one worker runs at a time.
    """

    queue: str
    above: int
    upto: int
    concurrency: int


LANES = (
    Lane("denoise-small", 0, 20_000, 4),
    Lane("denoise-medium", 20_000, 200_000, 2),
    Lane("denoise-large", 200_000, 2_000_000, 1),
    Lane("denoise", 2_000_000, 2**62, 1),
)


SHARDS_QUEUE, SHARD_CONCURRENCY = "shares", 2  # of large jobs; one of the two waits, so that its worker need not


def lane(total: int) -> Lane:
    """Return the lane of a job of so many points times iterations."""
    return next(lane for lane in LANES if total <= lane.upto)
