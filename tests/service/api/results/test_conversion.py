from __future__ import annotations

import asyncio
import errno
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from service.jobs.attempts import Attempts
from service.problems import Problem
from service.storage.base import sha256
from tests.support.service_process import Served


def _succeeded(served: Served, small: Path) -> str:
    """Submit a cloud and pretend that it is its own result; return the address of the job."""
    job = served.client.post("/denoise", files={"file": small.read_bytes()}).json()
    folder = served.app.state.settings.data_dir / "jobs" / job["id"]
    shutil.copy(folder / "upload", folder / "result.ply")
    attempts = Attempts(served.app.state.engine, 1000)
    attempts.acquire(job["id"])
    attempts.succeed(job["id"], {"ply": {"size": small.stat().st_size, "sha256": sha256(small)}}, [])
    return str(job["links"]["self"])


def test_a_format_more_keeps_to_the_disk_budget(make_served: Callable[..., Served], small: Path) -> None:
    served = make_served(disk_budget_bytes=7 * small.stat().st_size)
    first, second, third = (_succeeded(served, small) for _ in range(3))
    # 6 of 7 are taken and 2 wanted: the oldest job goes, though not the one that is asked about.
    assert served.client.get(f"{first}/result?format=pcd").status_code == 200
    assert [served.client.get(job).status_code for job in (first, second, third)] == [200, 410, 200]
    served.client.delete(third)
    alone = make_served(disk_budget_bytes=4 * small.stat().st_size)
    refused = alone.client.get(f"{first}/result?format=las")
    assert (refused.status_code, refused.json()["code"]) == (503, "disk_full")
    assert served.client.get(first).status_code == 200


@pytest.mark.parametrize("gone", ["removed", "expired"])
@pytest.mark.parametrize("moment", ["before", "reading", "converting", "written"])
def test_a_job_that_goes_meanwhile(
    make_served: Callable[..., Served], small: Path, monkeypatch: pytest.MonkeyPatch, gone: str, moment: str
) -> None:
    served = make_served()
    state = served.app.state
    job_id = _succeeded(served, small).rpartition("/")[2]
    job = state.jobs.status(job_id, "anonymous")

    def go() -> None:
        if gone == "removed":
            assert state.jobs.remove(job)
        else:
            state.retention._expire(job_id)

    def then(owner: object, name: str) -> None:
        """Have it go right before the method `name` of `owner`."""
        method = getattr(owner, name)

        def late(*arguments: object, **named: object) -> object:
            go()
            return method(*arguments, **named)

        monkeypatch.setattr(owner, name, late)

    if moment == "before":
        go()
    elif moment == "reading":
        then(state.storage, "reading")
    elif moment == "converting":
        then(state.converter._sandbox, "ask")
    else:
        then(state.storage, "put")
    with pytest.raises(Problem) as caught:
        asyncio.run(state.converter.with_format(job, "pcd"))
    assert (caught.value.code, caught.value.status) == ("job_expired", 410)
    assert job_id not in state.storage.job_ids()
    assert not list((state.settings.data_dir / "scratch").iterdir())


def test_a_full_disk_meanwhile(
    make_served: Callable[..., Served], small: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    served = make_served()
    job = _succeeded(served, small)

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(served.app.state.storage, "put", full)
    refused = served.client.get(f"{job}/result?format=pcd")
    assert (refused.status_code, refused.json()["code"]) == (503, "disk_full")
    assert refused.headers["retry-after"]
    assert not list((tmp_path / "data" / "scratch").iterdir())
    monkeypatch.undo()
    assert served.client.get(f"{job}/result?format=pcd").status_code == 200
