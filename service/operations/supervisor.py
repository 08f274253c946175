"""The supervisor of ``pcdnf serve``: it runs the API and a worker, and starts either again when it ends.

The supervisor lives as long as the service and does nothing but wait, so it is kept small. ``pcdnf serve`` checks the
settings, binds the socket and upgrades the database first. It then replaces itself by this module
(:func:`service.operations.serve.serve`), which imports the standard library alone.
"""

from __future__ import annotations

import argparse
import logging
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence

from ..supervision import EX_CONFIG, REFUSAL_VARIABLE, SOCKET_VARIABLE, SUPERVISOR_VARIABLE
from ..telemetry import logs

log = logging.getLogger("service.operations.supervisor")  # not __main__

FIRST_DELAY = 0.5
LONGEST_DELAY = 30.0
STEADY_SECONDS = 60.0  # a process that ran this long is started again without a delay
KILL_MARGIN = 5.0  # beyond the grace period
REPEAT_SECONDS = 0.5  # between two signals to one process


class Child:
    """A process that is started again whenever it ends.

    Parameters
    ----------
    name : str
        For the log.
    module : str
        Run with ``python -m``.
    environment : mapping of str to str
    descriptors : tuple of int
        File descriptors that the process inherits.
    """

    def __init__(self, name: str, module: str, environment: Mapping[str, str], descriptors: tuple[int, ...]) -> None:
        self.name = name
        self._command = [sys.executable, "-m", module]
        self._environment = dict(environment)
        self._descriptors = descriptors
        self._delay = FIRST_DELAY
        self._due = 0.0
        self._began = 0.0
        self.process: subprocess.Popen[bytes] | None = None

    def tend(self) -> int | None:
        """Start the process if it is due, and return its exit status once after it has ended."""
        now = time.monotonic()
        if self.process is None:
            if now >= self._due:
                self._began = now
                # A session of its own: Ctrl-C reaches it through the supervisor only, once.
                self.process = subprocess.Popen(
                    self._command, env=self._environment, pass_fds=self._descriptors, start_new_session=True
                )
            return None
        status = self.process.poll()
        if status is None:
            return None
        self.process = None
        if status == EX_CONFIG:
            return status
        if now - self._began > STEADY_SECONDS:
            self._delay = FIRST_DELAY
        self._due = now + self._delay
        log.warning("the %s ended with status %d; starting it again in %.1f s", self.name, status, self._delay)
        self._delay = min(2 * self._delay, LONGEST_DELAY)
        return status

    def signal(self, number: int) -> None:
        """Send a signal if the process runs; one that had ended before does not count for the exit status."""
        if self.process is None:
            return
        if self.process.poll() is None:
            self.process.send_signal(number)
        else:
            self.process = None

    def end(self, deadline: float, *, repeat: bool = False) -> bool:
        """Wait for the end of the process, and kill it at `deadline`.

        Parameters
        ----------
        deadline : float
            By the monotonic clock, in seconds.
        repeat : bool
            Send SIGTERM again and again. The kernel merges signals that a process has not taken yet, so a second one
            may be lost.

        Returns
        -------
        bool
            Whether the process ended by itself and well.
        """
        while self.process is not None:
            if repeat:
                self.process.send_signal(signal.SIGTERM)
            left = deadline - time.monotonic()
            try:
                status = self.process.wait(max(0.0, min(left, REPEAT_SECONDS)))
            except subprocess.TimeoutExpired:
                if left > 0:
                    continue
                log.warning("the %s did not stop in time and is killed", self.name)
                self.process.kill()
                self.process.wait()
                return False
            return status in (0, -signal.SIGTERM)  # while it imports it has no handler and nothing to finish
        return True


def supervise(listener: socket.socket, url: str, grace_seconds: float) -> int:
    """Serve on `listener` until SIGTERM or SIGINT.

    Parameters
    ----------
    listener : socket.socket
        Bound and listening.
    url : str
        Address of the service, printed when it starts.
    grace_seconds : float
        Time that the processes get to finish after the signal.

    Returns
    -------
    int
        0 after a clean stop, 1 if a process had to be killed, 78 if one refuses its settings.
    """
    refusals, refusal = os.pipe()
    environment = {**os.environ, SUPERVISOR_VARIABLE: str(os.getpid()), REFUSAL_VARIABLE: str(refusal)}
    descriptor = listener.fileno()
    api = Child("API", "service.api", environment | {SOCKET_VARIABLE: str(descriptor)}, (descriptor, refusal))
    worker = Child("worker", "service.worker", environment, (refusal,))
    stopping = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stopping.set())
    print(f"PCDNF listens on {url}", flush=True)
    result = 0
    # Not stopping.wait(): the handler runs in the thread that would wait, and could find the event's lock taken.
    while not stopping.is_set():
        if EX_CONFIG in [child.tend() for child in (api, worker)]:
            result = EX_CONFIG
            break
        time.sleep(0.1)
    listener.close()  # the API's is the last one now, so callers are refused as soon as the API closes it
    for child in (api, worker):
        child.signal(signal.SIGTERM)
    deadline = time.monotonic() + grace_seconds + KILL_MARGIN
    clean = [worker.end(deadline)]
    clean.append(api.end(deadline, repeat=True))  # until now it answered that the service is stopping
    _print_refusals(refusals, refusal)
    return result or (0 if all(clean) else 1)


def _print_refusals(reader: int, writer: int) -> None:
    """Print why a child refused to run. It is the last line, where a reader looks first."""
    os.close(writer)
    os.set_blocking(reader, False)  # a process that a child left behind may hold its end open
    with open(reader, "rb") as file:
        sys.stderr.write((file.read() or b"").decode("utf-8", "replace"))
    sys.stderr.flush()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the supervisor on a socket that this process has inherited; return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m service.operations.supervisor", description=__doc__)
    parser.add_argument("--socket", type=int, required=True, help="file descriptor of the listening socket")
    parser.add_argument("--url", required=True, help="address to print")
    parser.add_argument("--grace-seconds", type=float, required=True, help="time to finish after SIGTERM")
    parser.add_argument("--log-level", required=True)
    parser.add_argument("--log-format", required=True, choices=["text", "json"])
    given = parser.parse_args(arguments)
    logs.configure(given.log_level, given.log_format)
    return supervise(socket.socket(fileno=given.socket), given.url, given.grace_seconds)


if __name__ == "__main__":
    sys.exit(main())
