"""What the steps of a job work on: its upload, its files in storage, its prepared cloud, its progress."""

from __future__ import annotations

import errno
import logging
import time
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pcdnf.cloud import Frame
from pcdnf.denoiser import Cloud, Denoiser, Plan, Stopped, iteration_seed
from pcdnf.errors import PcdnfError
from pcdnf.file_formats import TEXT_FORMATS
from pcdnf.formats import Limits, PointCloud, read
from pcdnf.outliers import drop_outliers

from .job import Job
from .runtime import Runtime
from .storage import UPLOAD, job_file, own_name, writing

log = logging.getLogger(__name__)

RAW_NORMALS = "raw-normals.npz"
DIFFERS = "workers_differ"
POLL_SECONDS = 1.0  # between two looks at whether the job is still wanted
DISK_PATIENCE_SECONDS, DISK_RETRY_SECONDS = 300.0, 2.0  # of a step that finds the disk full
T = TypeVar("T")


class DiskFull(Exception):
    """The disk stays full."""


def with_room(runtime: Runtime, in_hand: str, work: Callable[[], T]) -> T:
    """Do the work of a job or share in hand, again for a while where the disk is full: what expires may make room.

    Raises
    ------
    DiskFull
    """
    deadline = time.monotonic() + DISK_PATIENCE_SECONDS
    while True:
        try:
            return work()
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT):
                raise
            if time.monotonic() > deadline:
                raise DiskFull from error
        log.warning("job %s waits: the disk is full", in_hand)
        time.sleep(DISK_RETRY_SECONDS)
        runtime.pause_if_stopping(in_hand)


def tile_name(iteration: int, start: int) -> str:
    """Return the name of a finished tile, one that nobody else has: of a worker taken for dead another may make it."""
    return own_name(f"tiles/{iteration}-{start}.npz")


def merged_name(iteration: int) -> str:
    """Return the name of the cloud after an iteration, one that nobody else has."""
    return own_name(f"iteration-{iteration}.npz")


def store_arrays(runtime: Runtime, job_id: str, name: str, **arrays: NDArray[Any]) -> None:
    """Store arrays durably under a name of the job."""
    with writing(runtime.storage, job_file(job_id, name)) as path, path.open("wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]


def load_arrays(runtime: Runtime, job_id: str, name: str) -> dict[str, NDArray[Any]]:
    """Return what :func:`store_arrays` stored; nothing is unpickled."""
    with (
        runtime.storage.reading(job_file(job_id, name)) as path,
        np.load(path, allow_pickle=False) as file,
    ):
        return dict(file)


def read_upload(runtime: Runtime, job: Job) -> PointCloud:
    """Read the caller's file, under the limits it was checked with, without outliers where they are to go.

    Raises
    ------
    pcdnf.formats.FormatError
    """
    limits = Limits(
        max_points=runtime.settings.max_points,
        max_bytes=runtime.settings.max_inflated_bytes,
        nonfinite=job.parameters["nonfinite"],
    )
    with runtime.storage.reading(job_file(job.id, UPLOAD)) as path:
        cloud = read(path, limits=limits, text=job.upload["format"] in TEXT_FORMATS)
    return drop_outliers(cloud) if job.parameters["outliers"] == "drop" else cloud


class Progress:
    """Progress of one step, told to the database at most once a second, which also tells whether to go on.

    Parameters
    ----------
    base : int
        Points done before this step, over all iterations.
    give_way : callable, optional
        See :meth:`Runtime.at_work`.

    Attributes
    ----------
    lent : float
        Seconds in which tiles of other jobs went first.
    """

    def __init__(self, runtime: Runtime, job: Job, base: int, give_way: Callable[[], float] = lambda: 0.0) -> None:
        self._runtime, self._job, self._base, self._give_way = runtime, job, base, give_way
        self._done = 0
        self.lent = 0.0
        self._began = self._told = time.monotonic()

    def report(self, done: int) -> None:
        """Take note of the points of this step done so far."""
        self._done = done

    def stop(self) -> bool:
        """Return whether the job is not wanted any more; looks once a second."""
        self.lent += self._give_way()
        now = time.monotonic()
        if now - self._told < POLL_SECONDS:
            return False
        self._told = now
        speed = self._runtime.speed(form(self._job)) or (self._done / (now - self._began - self.lent) or None)
        record = self._runtime.record(self._job)
        return not record.wanted(self._job.work, done=self._base + self._done, points_per_second=speed)

    def check(self) -> None:
        """Raise :class:`pcdnf.denoiser.Stopped` where :meth:`stop` says so."""
        if self.stop():
            raise Stopped


@dataclass(frozen=True)
class Pass:
    """One iteration: its number, the merged cloud of the one before, and the order of its points once that is known."""

    iteration: int
    before: str | None
    order: int | None = None


@dataclass
class Prepared:
    """The cloud of one iteration made ready, kept in memory between the tiles; `order` sums up that of its points."""

    iteration: int
    denoiser: Denoiser
    cloud: Cloud
    order: int


def prepared(runtime: Runtime, job: Job, now: Pass) -> Prepared:
    """Return the cloud of an iteration, prepared now unless it was kept.

    Raises
    ------
    PcdnfError
        If the file, the cloud or the model is not usable, or the weights are not those the job began with.
    pcdnf.denoiser.Stopped
        If the job was cancelled meanwhile.
    """
    progress = Progress(runtime, job, 0)
    with runtime.preparing(job, progress.check):
        kept = runtime.kept.get(job.id)
        if not isinstance(kept, Prepared) or kept.iteration != now.iteration:
            kept = _prepare(runtime, job, now, progress)
    if now.order is not None and kept.order != now.order:
        raise PcdnfError(
            "This worker put the points of the cloud into another order than the one that began the job.",
            code=DIFFERS,
            hint="Submit the file again. Workers that share a queue should run on one kind of machine.",
        )
    return kept


def _prepare(runtime: Runtime, job: Job, now: Pass, progress: Progress) -> Prepared:
    iteration = now.iteration
    with runtime.at_work(job, progress.check), runtime.stage("prepare"):
        runtime.kept.pop(job.id, None)  # the cloud before may be large
        runtime.drop_idle(0)
        denoiser = settled(runtime, job)
        given = read_upload(runtime, job)
        points: NDArray[Any] = given.points
        normals = given.normals
        if now.before is not None:
            merged = load_arrays(runtime, job.id, now.before)
            points, normals = merged["points"], merged["normals"]
        cloud = denoiser.prepare(
            points,
            normals,
            plan=planned(job),
            iteration=iteration,
            frame=Frame.of(given.points),
            initial="input" if iteration else job.parameters["normals"],
            seed=iteration_seed(job.parameters["seed"], iteration),
            should_stop=progress.stop,
        )
        fresh = Prepared(iteration, denoiser, cloud, zlib.crc32(cloud.order.tobytes()))
        runtime.kept[job.id] = fresh
        return fresh


def settled(runtime: Runtime, job: Job) -> Denoiser:
    """Return the job's model, having recorded on what the job runs; the weights may not change under it.

    Raises
    ------
    PcdnfError
        If the weights are not those the job began with.
    """
    execution = runtime.models.execution(job.parameters["model"])
    known = job.execution or {}
    if known and known["weights_sha256"] != execution["weights_sha256"]:
        raise PcdnfError(
            "The service was updated to other weights while this job was under way.",
            code="model_changed",
            hint="Submit the file again.",
        )
    if job.share is None and known != known | execution:
        runtime.attempts.update(job.id, execution=known | execution)
    return runtime.models.get(job.parameters["model"])


def form(job: Job) -> str:
    """Return what sets a job's speed: its model, and whether it takes the fast form of it."""
    fast = job.parameters.get("fast", False)  # which jobs of before this release have not
    return f"{job.parameters['model']}{' fast' if fast else ''}"


def planned(job: Job) -> Plan:
    """Return the plan that the first step of the job left with it."""
    assert job.execution is not None
    return Plan.from_json(job.execution["plan"])
