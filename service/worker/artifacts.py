"""The files of a job that its steps read and write: the upload, tiles and merged clouds."""

from __future__ import annotations

import errno
import logging
import time
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pcdnf.file_formats import TEXT_FORMATS
from pcdnf.formats import Limits, PointCloud, read
from pcdnf.formats.aside import points_to_fit
from pcdnf.formats.scanner_positions import scanner_places
from pcdnf.geometry.outliers import treat_outliers
from pcdnf.inference.options import check_sensor

from ..jobs.files import UPLOAD, job_file
from ..jobs.job import Job, ignored_classes
from ..storage.base import own_name, writing
from .context import Runtime

log = logging.getLogger(__name__)

INITIAL_NORMALS = "raw-normals.npz"


DISK_PATIENCE_SECONDS, DISK_RETRY_SECONDS = 300.0, 2.0  # of a step, while the disk is full


T = TypeVar("T")


class DiskFullError(Exception):
    """The disk was full for five minutes."""


def retry_while_disk_full(runtime: Runtime, in_hand: str, work: Callable[[], T]) -> T:
    """Run `work`, retrying for up to five minutes while the disk is full.

    Expiring results may free space in the meantime.

    Raises
    ------
    DiskFullError
    """
    deadline = time.monotonic() + DISK_PATIENCE_SECONDS
    while True:
        try:
            return work()
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT):
                raise
            if time.monotonic() > deadline:
                raise DiskFullError from error
        log.warning("job %s waits: the disk is full", in_hand)
        time.sleep(DISK_RETRY_SECONDS)
        runtime.in_flight.pause_if_stopping(in_hand)


def tile_name(iteration: int, start: int) -> str:
    """Return a unique name for a finished tile: two workers may compute it, if one of them was taken for dead."""
    return own_name(f"tiles/{iteration}-{start}.npz")


def merged_name(iteration: int) -> str:
    """Return a unique name for the cloud after an iteration."""
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
    """Read the upload under the limits of its check; put aside what no fit uses, and drop or mark outliers if asked.

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
    cloud = points_to_fit(cloud, ignored_classes(job.parameters.get("ignore_classes", "")))
    if job.parameters["outliers"] == "keep":
        return cloud
    sensor = check_sensor(job.parameters.get("sensor", ""))
    return treat_outliers(cloud, job.parameters["outliers"], scanner_places(cloud, sensor))
