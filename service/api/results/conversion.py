"""Results in formats that the worker did not store. A child process writes them on first demand, and they are kept."""

from __future__ import annotations

import asyncio
from contextlib import ExitStack

from starlette.concurrency import run_in_threadpool

from ...jobs.files import job_file, result_facts, result_file
from ...jobs.job import Job
from ...jobs.retention import Retention
from ...jobs.store import Jobs
from ...problems import Problem, disk_full, job_expired
from ...storage.base import Storage, own_name
from ..intake.inspection import file_problem
from ..sandbox import Sandbox

GROWTH = 2  # room made for a format, in sizes of the one that came in


class Converter:
    """Adds formats to finished jobs, one at a time.

    Parameters
    ----------
    sandbox : Sandbox
    jobs : Jobs
    storage : Storage
    retention : Retention
        Makes room for what is written.
    """

    def __init__(self, sandbox: Sandbox, jobs: Jobs, storage: Storage, retention: Retention) -> None:
        self._sandbox, self._jobs, self._storage, self._retention = sandbox, jobs, storage, retention
        self._turn = asyncio.Lock()

    async def with_format(self, job: Job, format_: str) -> Job:
        """Return the job, which has succeeded, with its result in `format_`, too.

        Raises
        ------
        Problem
            410 where the job has gone meanwhile, 422 where the format cannot hold the cloud, 503 where the disk is
            full.
        """
        async with self._turn:
            now = await run_in_threadpool(self._still, job)
            if format_ in (now.results or {}):
                return now  # another request was first
            try:
                return await self._convert(now, format_)
            except FileNotFoundError:
                raise job_expired() from None
            except Problem:
                await run_in_threadpool(self._still, job)  # or its files went while the child process read them
                raise

    def _still(self, job: Job) -> Job:
        """Return the job as it is now."""
        now = self._jobs.status(job.id, job.owner)
        if now is None or self._jobs.expired(now):
            raise job_expired()
        return now

    async def _convert(self, job: Job, format_: str) -> Job:
        results = job.results or {}
        own = job.upload["format"]
        await run_in_threadpool(self._retention.make_room, GROWTH * results[own]["size"], keep=job.id)
        name, scratch = own_name(f"result.{format_}"), self._storage.scratch()
        with ExitStack() as stack:
            stack.callback(scratch.unlink, missing_ok=True)
            source = await run_in_threadpool(stack.enter_context, self._storage.reading(result_file(job, own)))
            options = ["--coordinates", job.parameters.get("coordinates", "keep")]
            answer = await self._sandbox.ask(
                "pcdnf.formats.sandbox.convert", str(source), str(scratch), format_, *options
            )
            if answer.get("code") == "disk_full":
                raise disk_full()
            if not answer["ok"]:
                raise file_problem(answer)
            facts = await run_in_threadpool(result_facts, scratch, name)
            await run_in_threadpool(self._storage.put, scratch, job_file(job.id, name))
        added = await run_in_threadpool(self._jobs.add_result, job, format_, facts, answer["warnings"])
        if added is None:
            await run_in_threadpool(self._storage.delete_job, job.id)
            raise job_expired()
        return added
