"""The agreements between the supervisor and the processes that it starts.

The supervisor imports this module, so it imports nothing that is large.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from contextlib import suppress

EX_CONFIG = 78
"""Exit status of a process that refuses its settings (sysexits.h); the supervisor does not start it again."""

SUPERVISOR_VARIABLE = "PCDNF_SUPERVISOR_PID"
"""Environment variable with the process id of the supervisor."""

SOCKET_VARIABLE = "PCDNF_SOCKET_FD"
"""Environment variable with the file descriptor of the listening socket that the API inherits."""

REFUSAL_VARIABLE = "PCDNF_REFUSAL_FD"
"""Environment variable with the file descriptor on which a child says why it refuses to run."""

_PR_SET_PDEATHSIG = 1


def is_supervised() -> bool:
    """Return whether the parent of this process is a supervisor that still runs."""
    return os.environ.get(SUPERVISOR_VARIABLE) == str(os.getppid())


def say_refusal(text: str) -> None:
    """Say why this process refuses to run: on standard error, or to the supervisor, which prints it last."""
    line = f"pcdnf: {text}"
    if is_supervised() and REFUSAL_VARIABLE in os.environ:
        with suppress(OSError):
            os.write(int(os.environ[REFUSAL_VARIABLE]), f"{line}\n".encode())
            return
    print(line, file=sys.stderr)


def end_with_supervisor() -> None:
    """Ask the kernel for SIGTERM when the supervisor ends, for whatever reason (Linux).

    Raises
    ------
    SystemExit
        If the supervisor has ended already.
    """
    if SUPERVISOR_VARIABLE not in os.environ:
        return
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if not is_supervised():
        sys.exit(0)
