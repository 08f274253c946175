from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.support.service_process import Served


def test_the_upload_is_on_the_disk_before_its_job_is_accepted(
    make_served: Callable[..., Served], small: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    served = make_served()
    jobs, folder = served.app.state.jobs, served.app.state.settings.data_dir.resolve() / "jobs"
    synced: list[Path] = []
    before: list[Path] = []
    fsync, submit = os.fsync, jobs.submit_all

    def noted(descriptor: int) -> None:
        synced.append(Path(os.readlink(f"/proc/self/fd/{descriptor}")))
        fsync(descriptor)

    def late(new: Any, **named: Any) -> Any:
        before.extend(synced)
        return submit(new, **named)

    monkeypatch.setattr(os, "fsync", noted)
    monkeypatch.setattr(jobs, "submit_all", late)
    job = served.client.post("/denoise", files={"file": small.read_bytes()}).json()
    assert [path.parent.name for path in before[:1]] == ["scratch"]
    assert before[1:] == [folder / job["id"], folder]
