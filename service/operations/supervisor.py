"""One command, two child processes: the API and a worker, either started again when it dies."""

from __future__ import annotations

import logging
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Mapping

from ..api.listener import SOCKET_VARIABLE, url
from ..database.migrations import migrate
from ..settings import Settings
from ..startup import EX_CONFIG, SUPERVISOR_VARIABLE

log = logging.getLogger(__name__)

FIRST_DELAY = 0.5
LONGEST_DELAY = 30.0
STEADY_SECONDS = 60.0  # after so long alive, the next death is answered without delay again
KILL_MARGIN = 5.0  # beyond the grace period


class Child:
    """A process that is kept alive."""

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
        """Start the process if it is due, and return its exit status once when it has died."""
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
        if now - self._began > STEADY_SECONDS:
            self._delay = FIRST_DELAY
        self._due = now + self._delay
        log.warning("the %s ended with status %d; starting it again in %.1f s", self.name, status, self._delay)
        self._delay = min(2 * self._delay, LONGEST_DELAY)
        return status

    def signal(self, number: int) -> None:
        """Send a signal if it runs; one that had died before is none of the stop's affair."""
        if self.process is None:
            return
        if self.process.poll() is None:
            self.process.send_signal(number)
        else:
            self.process = None

    def wait(self, deadline: float) -> bool:
        """Wait for its end, kill it at `deadline`; return whether it ended by itself and well."""
        if self.process is None:
            return True
        try:
            status = self.process.wait(max(0.0, deadline - time.monotonic()))
            return status in (0, -signal.SIGTERM)  # still importing, it has no handler yet and nothing to finish
        except subprocess.TimeoutExpired:
            log.warning("the %s did not stop in time and is killed", self.name)
            self.process.kill()
            self.process.wait()
            return False


def supervise(settings: Settings, listener: socket.socket) -> int:
    """Serve on `listener` until SIGTERM or SIGINT.

    Returns
    -------
    int
        0 after a clean stop, 1 if a child had to be killed, 78 if a child refuses its settings.
    """
    migrate(settings)
    environment = {**os.environ, SUPERVISOR_VARIABLE: str(os.getpid())}
    descriptor = listener.fileno()
    api = {**environment, SOCKET_VARIABLE: str(descriptor)}
    children = [
        Child("API", "service.api", api, (descriptor,)),
        Child("worker", "service.worker", environment, ()),
    ]
    stopping = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stopping.set())
    print(f"PCDNF listens on {url(settings, listener)}", flush=True)
    result = 0
    # Not stopping.wait(): a signal's handler that sets an event its own thread waits for can find its lock taken.
    while not stopping.is_set():
        if EX_CONFIG in [child.tend() for child in children]:
            result = EX_CONFIG
            break
        time.sleep(0.1)
    listener.close()  # from here on the API's is the last one, and once that is closed callers are not kept waiting
    for child in children:
        child.signal(signal.SIGTERM)
    deadline = time.monotonic() + settings.grace_seconds + KILL_MARGIN
    api_process, worker = children
    clean = [worker.wait(deadline)]
    api_process.signal(signal.SIGTERM)  # until now it told callers that the service stops
    clean.append(api_process.wait(deadline))
    return result or (0 if all(clean) else 1)
