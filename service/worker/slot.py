"""The slot of a worker: a lock file that allows one process for each worker name."""

from __future__ import annotations

import fcntl
import time
from typing import IO

from ..settings import Settings

LOCK_WAIT_SECONDS = 20.0  # for a worker of the same name that is still on its way out


class SlotTakenError(Exception):
    """Another live process works under this name."""


def take_slot(settings: Settings) -> IO[str]:
    """Hold the lock file of this worker's name for as long as the returned file is open.

    Raises
    ------
    SlotTakenError
        If another process keeps holding it.
    """
    folder = settings.data_dir / "locks"
    folder.mkdir(parents=True, exist_ok=True)
    file = (folder / f"{settings.executor_id}.lock").open("a")
    deadline = time.monotonic() + LOCK_WAIT_SECONDS
    while True:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return file
        except BlockingIOError:
            if time.monotonic() > deadline:
                file.close()
                raise SlotTakenError(
                    f"Another worker named {settings.executor_id} is running on {settings.data_dir}. "
                    "Set PCDNF_WORKER_ID to another name for this one."
                ) from None
            time.sleep(0.2)
