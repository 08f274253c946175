"""Progress on standard error: bars on a terminal, lines elsewhere."""

from __future__ import annotations

import os
import sys
from typing import Protocol

from tqdm import tqdm

from ..client.schemas import Job

LINE_SHARE, LINE_BYTES = 0.1, 1 << 28
"""Share of a job, and bytes of an upload, after which another line is printed."""
COLUMNS, ROWS = 80, 24
"""Size that is assumed if the terminal reports none."""


class Display(Protocol):
    """Where progress is shown."""

    def upload(self, name: str, done: int, total: int) -> None:
        """Show the progress of an upload, in bytes."""

    def job(self, name: str, job: Job) -> None:
        """Show the state of a job."""

    def note(self, text: str) -> None:
        """Print a sentence that stays on the screen."""

    def clear(self) -> None:
        """Remove what is shown: nothing is in progress."""


def choose(*, quiet: bool) -> Display:
    """Choose the display that suits standard error."""
    if quiet:
        return Quiet()
    return Bars() if sys.stderr.isatty() else Lines()


class Quiet:
    """Prints notes only."""

    def upload(self, name: str, done: int, total: int) -> None:
        """Do nothing."""

    def job(self, name: str, job: Job) -> None:
        """Do nothing."""

    def note(self, text: str) -> None:
        """Print a line."""
        print(f"pcdnf: {text}", file=sys.stderr, flush=True)

    def clear(self) -> None:
        """Do nothing."""


class Lines(Quiet):
    """Prints a line for every step and every tenth of a job."""

    def __init__(self) -> None:
        self._last: tuple[str, object] | None = None

    def upload(self, name: str, done: int, total: int) -> None:
        """Print a line at the start and after every 256 MiB."""
        self._say(name, f"uploading, {_bytes(done)} of {_bytes(total)}", done // LINE_BYTES)

    def job(self, name: str, job: Job) -> None:
        """Print a line when something changed."""
        if job.status == "queued":
            self._say(name, _queued(job), job.queue_position)
        elif job.live:
            share = job.progress.done / max(job.progress.total, 1)
            self._say(name, f"{share:.0%}{_speed(job)}", int(share / LINE_SHARE))

    def _say(self, name: str, text: str, key: object) -> None:
        if self._last != (name, key):
            self._last = (name, key)
            self.note(f"{name}: {text}")


class Bars:
    """Shows one bar at a time: the upload, the queue, the job."""

    def __init__(self) -> None:
        self._bar: tqdm | None = None
        self._shows: tuple[str, str] | None = None

    def upload(self, name: str, done: int, total: int) -> None:
        """Show bytes, their rate and the time left."""
        bar = self._show(name, "upload", total, unit="B", unit_scale=True, unit_divisor=1024)
        bar.update(done - bar.n)

    def job(self, name: str, job: Job) -> None:
        """Show the place in the queue, then points, speed and time as the service reports them."""
        if job.status == "queued":
            bar = self._show(name, _queued(job), 1, bar_format="{desc} [{elapsed}]")
            bar.refresh()
            return
        layout = "{l_bar}{bar}| {n_fmt}/{total_fmt} points [{elapsed}{postfix}]"
        what = "stopping" if job.status == "cancelling" else "denoise"
        bar = self._show(name, what, job.progress.total, bar_format=layout, unit_scale=True)
        bar.set_postfix_str(_speed(job).removeprefix(", "), refresh=False)
        bar.update(job.progress.done - bar.n)
        bar.refresh()

    def note(self, text: str) -> None:
        """Print a line above the bar."""
        tqdm.write(f"pcdnf: {text}", file=sys.stderr)

    def clear(self) -> None:
        """Remove the bar."""
        if self._bar is not None:
            self._bar.close()
        self._bar = self._shows = None

    def _show(self, name: str, what: str, total: int, **options: object) -> tqdm:
        """Return the bar of a step, in place of the previous one."""
        if self._bar is None or self._shows != (name, what):
            self.clear()
            known = os.get_terminal_size(sys.stderr.fileno()).columns > 0
            width = {"dynamic_ncols": True} if known else {"ncols": COLUMNS, "nrows": ROWS}
            self._bar = tqdm(total=total, desc=f"{name}: {what}", file=sys.stderr, leave=False, **width, **options)
            self._shows = (name, what)
        return self._bar


def _queued(job: Job) -> str:
    place = "queued" if job.queue_position is None else f"queued, position {job.queue_position}"
    return place if job.seconds_left is None else f"{place}, done in about {_duration(job.seconds_left)}"


def _speed(job: Job) -> str:
    speed = "" if job.points_per_second is None else f", {job.points_per_second:,.0f} points/s"
    return speed if job.seconds_left is None else f"{speed}, {_duration(job.seconds_left)} left"


def _duration(seconds: float) -> str:
    return str(tqdm.format_interval(seconds))


def _bytes(size: int) -> str:
    return str(tqdm.format_sizeof(size, "B", 1024))
