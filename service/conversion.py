"""Results in formats the worker did not store: written on first demand by a child process, kept with the others."""

from __future__ import annotations

import asyncio

from starlette.concurrency import run_in_threadpool

from .children import Children
from .inspection import file_problem
from .job import Job
from .jobs import Jobs
from .settings import Settings
from .storage import Storage, job_file, sha256
from .uploads import disk_full


class Converter:
    """Adds formats to finished jobs, one at a time.

    Parameters
    ----------
    children : Children
    jobs : Jobs
    storage : Storage
    settings : Settings
        For the disk space to leave free.
    """

    def __init__(self, children: Children, jobs: Jobs, storage: Storage, settings: Settings) -> None:
        self._children, self._jobs, self._storage, self._settings = children, jobs, storage, settings
        self._turn = asyncio.Lock()

    async def with_format(self, job: Job, format_: str) -> Job:
        """Return the job, which has succeeded, with its result in `format_`, too.

        Raises
        ------
        Problem
            422 where the format cannot hold the cloud, 503 where the disk is full.
        """
        async with self._turn:
            now = await run_in_threadpool(self._jobs.status, job.id, job.owner)
            if now is not None and format_ in (now.results or {}):
                return now  # another request was first
            return await self._convert(now or job, format_)

    async def _convert(self, job: Job, format_: str) -> Job:
        results = job.results or {}
        own = job.upload["format"]
        if self._storage.free_bytes() < self._settings.min_free_bytes + 2 * results[own]["size"]:
            raise disk_full()
        source, scratch = self._storage.local(job_file(job.id, f"result.{own}")), self._storage.scratch()
        try:
            answer = await self._children.ask("pcdnf.formats.convert", str(source), str(scratch), format_)
            if not answer["ok"]:
                raise file_problem(answer)
            facts = {"size": scratch.stat().st_size, "sha256": await run_in_threadpool(sha256, scratch)}
            await run_in_threadpool(self._storage.put, scratch, job_file(job.id, f"result.{format_}"))
        finally:
            scratch.unlink(missing_ok=True)
        return await run_in_threadpool(self._jobs.add_result, job, format_, facts, answer["warnings"])
