"""Read a file under resource limits and say what it is: ``python -m pcdnf.formats.check PATH``.

Prints one JSON object and ends with status 0, whatever the file holds::

    {"ok": true, "format": "ply", "points": 100000, "has_normals": false, "dropped": 0, "warnings": []}
    {"ok": false, "code": "truncated", "detail": "…", "hint": "…", "limit": 1200180, "actual": 1048576}

A server calls it for each upload, so that no upload is parsed in the process that speaks HTTP.
"""

from __future__ import annotations

import argparse
import errno
import json
import resource
import signal
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

from .cloud import Limits
from .errors import FormatError
from .files import read

_GRACE_SECONDS = 5
"""Between the signal that is answered with JSON and the kernel's kill."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry of ``python -m pcdnf.formats.check``."""
    parser = argparse.ArgumentParser(prog="python -m pcdnf.formats.check", description="Check a point-cloud file.")
    parser.add_argument("path")
    parser.add_argument("--limits-json", default="{}", help="fields of pcdnf.formats.Limits")
    parser.add_argument("--text", action="store_true", help="without known first bytes it is columns of text")
    add_restraints(parser)
    given = parser.parse_args(arguments)
    try:
        limits = Limits(**json.loads(given.limits_json))
    except (TypeError, ValueError) as error:
        parser.error(f"--limits-json: {error}")
    restrain(given.memory_bytes, given.cpu_seconds)
    print(json.dumps(guarded(lambda: describe(given.path, limits, text=given.text))))


def guarded(work: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """What ``work`` returns, or the refusal it ends with, as a JSON object."""
    try:
        return work()
    except FormatError as error:
        return _refusal(error)
    except MemoryError:
        return _refusal(
            FormatError(
                "Reading the file needs more memory than the server gives it.",
                code="not_enough_memory",
                hint="Cut the cloud into parts, or thin it out.",
            )
        )
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        return _refusal(FormatError("The disk is full.", code="disk_full", hint="Try again later."))


def describe(path: str, limits: Limits, *, text: bool) -> dict[str, Any]:
    """What :func:`main` prints for a file that can be read."""
    cloud = read(path, limits=limits, text=text)
    return {
        "ok": True,
        "format": cloud.flavour.format,
        "points": len(cloud),
        "has_normals": cloud.normals is not None,
        "dropped": len(cloud.dropped),
        "warnings": cloud.warnings,
    }


def _refusal(error: FormatError) -> dict[str, Any]:
    return {
        "ok": False,
        "code": error.code,
        "detail": str(error),
        "hint": error.hint,
        "limit": error.limit,
        "actual": error.actual,
    }


def add_restraints(parser: argparse.ArgumentParser) -> None:
    """Add the options for :func:`restrain`."""
    parser.add_argument("--memory-bytes", type=int, help="address space that the work may add")
    parser.add_argument("--cpu-seconds", type=int, help="processor time that the work may take")


def restrain(memory_bytes: int | None, cpu_seconds: int | None) -> None:
    """Limit what this process may still take."""
    if memory_bytes is not None:
        statm = Path("/proc/self/statm")
        mapped = int(statm.read_text().split()[0]) * resource.getpagesize() if statm.exists() else 0
        resource.setrlimit(resource.RLIMIT_AS, (mapped + memory_bytes, mapped + memory_bytes))
    if cpu_seconds is not None:
        signal.signal(signal.SIGXCPU, _out_of_time)
        resource.setrlimit(resource.RLIMIT_CPU, (cpu_seconds, cpu_seconds + _GRACE_SECONDS))


def _out_of_time(_signal: int, _frame: FrameType | None) -> NoReturn:
    raise FormatError(
        "Reading the file takes more time than the server gives it.",
        code="took_too_long",
        hint="Send it as binary PLY.",
    )


if __name__ == "__main__":
    main()
