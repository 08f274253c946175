"""The check of an upload, in a child process under limits of memory and time; nothing is parsed here."""

from __future__ import annotations

import asyncio
import json
import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .parameters import Parameters
from .problems import CATALOGUE, Problem
from .settings import Settings

MINIMUM_POINTS = 16  # what the denoiser needs; a test compares the two
WALL_FACTOR = 4.0  # clock seconds a check may take for each second of processor time it is granted


@dataclass(frozen=True)
class Inspection:
    """What the check found."""

    format: str
    points: int
    has_normals: bool
    warnings: list[str]


class Inspector:
    """Runs checks, a few at a time.

    Parameters
    ----------
    settings : Settings
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._turn = asyncio.Semaphore(settings.concurrent_checks)

    async def inspect(self, path: Path, parameters: Parameters) -> Inspection:
        """Check the file at `path`.

        Raises
        ------
        Problem
            413, 415 or 422 with the code of what is wrong with the file.
        """
        async with self._turn:
            answer = await self._ask(path, parameters)
        if not answer["ok"]:
            raise file_problem(answer)
        found = Inspection(answer["format"], answer["points"], answer["has_normals"], answer["warnings"])
        if parameters.normals == "input" and not found.has_normals:
            raise Problem(
                "normals_missing", "The file has no normals, but normals=input was asked for.",
                hint="Leave `normals` out to have them estimated.",
            )  # fmt: skip
        return found

    async def _ask(self, path: Path, parameters: Parameters) -> dict[str, Any]:
        settings = self._settings
        limits = {
            "max_points": settings.max_points,
            "max_bytes": settings.max_inflated_bytes,
            "minimum_points": MINIMUM_POINTS,
            "nonfinite": parameters.nonfinite,
        }
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "pcdnf.formats.check", str(path),
            "--limits-json", json.dumps(limits),
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
            return _refused("took_too_long", "Reading the file takes more time than the server gives it.")
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
        if process.returncode != 0:
            return _refused("not_enough_memory", "Reading the file ended its checker, most likely for want of memory.")
        answer: dict[str, Any] = json.loads(output)
        return answer


def _refused(code: str, detail: str) -> dict[str, Any]:
    return {
        "ok": False,
        "code": code,
        "detail": detail,
        "hint": "Cut the cloud into parts, or send it as binary PLY.",
    }


def file_problem(answer: dict[str, Any]) -> Problem:
    """Return the problem for a refusal of the checker: 413 or 415 where the catalogue says so, else 422."""
    code = answer["code"]
    return Problem(
        code,
        answer["detail"],
        hint=answer["hint"],
        status=None if code in CATALOGUE else 422,
        title=None if code in CATALOGUE else "The file is not a usable point cloud",
        limit=answer.get("limit"),
        actual=answer.get("actual"),
    )
