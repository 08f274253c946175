"""Names of a job's files in storage."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..storage.base import sha256
from .job import Job

UPLOAD = "upload"


DISPLAY = "display.glb"


def job_file(job_id: str, name: str) -> str:
    """Return the name in storage of one file of a job."""
    return f"jobs/{job_id}/{name}"


def result_facts(path: Path, name: str) -> dict[str, Any]:
    """Return what the row of a job says about the result at `path`, which is stored as `name`."""
    return {"file": name, "size": path.stat().st_size, "sha256": sha256(path)}


def result_name(format_: str, facts: dict[str, Any]) -> str:
    """Return under which name of the job a result is stored."""
    name: str = facts.get("file", f"result.{format_}")  # the name in older versions
    return name


def result_file(job: Job, format_: str) -> str:
    """Return the name in storage of a result that `job` has."""
    assert job.results is not None
    return job_file(job.id, result_name(format_, job.results[format_]))
