from __future__ import annotations

from service.jobs.lanes import LANES, lane


def test_every_size_has_one_lane() -> None:
    assert LANES[0].above == 0
    assert [each.above for each in LANES[1:]] == [each.upto for each in LANES[:-1]]
    assert [lane(total).queue for total in (1, 20_000, 20_001, 200_000, 2_000_000, 2_000_001, 10**12)] == [
        "denoise-small", "denoise-small", "denoise-medium", "denoise-medium", "denoise-large", "denoise", "denoise",
    ]  # fmt: skip


def test_large_clouds_are_not_all_in_memory() -> None:
    assert sum(each.concurrency for each in LANES if each.upto > 200_000) == 2
    assert sum(each.concurrency * each.upto for each in LANES[:-1]) < 2_500_000
