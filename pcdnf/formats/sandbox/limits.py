"""Memory and time limits of a child process that handles a file, and refusals as JSON."""

from __future__ import annotations

import argparse
import errno
import resource
import signal
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

from ..errors import FormatError

_GRACE_SECONDS = 5
"""Between the signal that is answered with JSON and the kernel's kill."""


def guarded(work: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Return the result of `work`, or the refusal that it ends with, as a JSON object."""
    try:
        return work()
    except FormatError as error:
        return _refusal(error)
    except MemoryError:
        return _refusal(
            FormatError(
                "Reading the file needs more memory than the server allows.",
                code="not_enough_memory",
                hint="Cut the cloud into parts, or thin it out.",
            )
        )
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        return _refusal(FormatError("The disk is full.", code="disk_full", hint="Try again later."))


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
        "Reading the file takes more time than the server allows.",
        code="took_too_long",
        hint="Send it as binary PLY.",
    )
