"""Child processes that read callers' files, with limits of memory and time, a few at a time."""

from __future__ import annotations

import asyncio
import json
import logging
import math
import sys
from typing import Any

from ..problems import unexpected
from ..settings import Settings

log = logging.getLogger(__name__)

WALL_FACTOR = 4.0  # clock seconds a child may take for each second of processor time it is granted


class Sandbox:
    """Runs modules of ``pcdnf.formats`` that answer with one JSON object.

    Parameters
    ----------
    settings : Settings
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._turn = asyncio.Semaphore(settings.concurrent_checks)

    async def ask(self, module: str, *arguments: str) -> dict[str, Any]:
        """Return the answer of ``python -m module arguments``, a refusal where the child broke a limit.

        Raises
        ------
        Problem
            500 where the child failed otherwise.
        """
        async with self._turn:
            return await self._run(module, *arguments)

    async def _run(self, module: str, *arguments: str) -> dict[str, Any]:
        settings = self._settings
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", module, *arguments,
            "--memory-bytes", str(settings.check_memory_bytes),
            "--cpu-seconds", str(math.ceil(settings.check_seconds)),
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.DEVNULL,
        )  # fmt: skip
        try:
            async with asyncio.timeout(WALL_FACTOR * settings.check_seconds):
                output, _ = await process.communicate()
        except TimeoutError:
            return _refused("took_too_long", "Reading the file takes longer than this service allows.")
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
        if process.returncode:
            log.error("the child process %s ended with status %d", module, process.returncode)
            if process.returncode > 0:  # no signal, so a defect: want of memory is answered, or ends it with one
                raise unexpected()
            return _refused(
                "not_enough_memory",
                "The process that reads the file ended unexpectedly, most likely because it ran out of memory.",
            )
        answer: dict[str, Any] = json.loads(output)
        return answer


def _refused(code: str, detail: str) -> dict[str, Any]:
    return {
        "ok": False,
        "code": code,
        "detail": detail,
        "hint": "Split the cloud into smaller parts, or send it as binary PLY.",
    }
