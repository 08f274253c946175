from __future__ import annotations

import threading

import pytest

from service.worker.cloud_cache import CloudCache


def test_a_cloud_goes_with_the_workflow_of_its_job() -> None:
    clouds: CloudCache[str] = CloudCache()
    with clouds.used_by("job", is_shard=False):
        clouds.put("job", "cloud")
        assert clouds.get("job") == "cloud"
    assert clouds.get("job") is None


def test_a_cloud_outlives_a_shard_for_a_while() -> None:
    clouds: CloudCache[str] = CloudCache()
    with clouds.used_by("job", is_shard=True):
        clouds.put("job", "cloud")
    clouds.remove_idle()
    assert clouds.get("job") == "cloud"
    with clouds.used_by("job", is_shard=True):  # the next shard of the same job
        clouds.remove_idle(0)
        assert clouds.get("job") == "cloud"
    clouds.remove_idle(0)
    assert clouds.get("job") is None


def test_a_cloud_stays_while_its_job_waits_for_shards_elsewhere() -> None:
    clouds: CloudCache[str] = CloudCache()
    with clouds.used_by("job", is_shard=False):
        with clouds.used_by("job", is_shard=True):
            clouds.put("job", "cloud")
        clouds.remove_idle(0)
        assert clouds.get("job") == "cloud"


def test_one_shard_prepares_and_the_others_poll(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.worker.cloud_cache.POLL_SECONDS", 0.01)
    clouds: CloudCache[str] = CloudCache()
    polled, finished = threading.Event(), threading.Event()

    def other() -> None:
        with clouds.preparing("job", polled.set):
            finished.set()

    with clouds.preparing("job", lambda: None):
        thread = threading.Thread(target=other)
        thread.start()
        assert polled.wait(5)
        assert not finished.is_set()
    thread.join(5)
    assert finished.is_set()
