"""The client: one method for each request of the service."""

from __future__ import annotations

import os
import secrets
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import TracebackType

from ..errors import PcdnfError
from ..file_formats import SUFFIXES
from ..formats.files import replacing
from .errors import JobError
from .responses import retry_after
from .retries import Notify
from .schemas import Job, Model, ProblemDetail
from .session import LONG_TIMEOUT, Session
from .transfers import BytesDone, CountedFile, Download
from .transport import DEFAULT_URL

PATIENCE_SECONDS = 300.0
PAGE = 100
_POLL_SECONDS = 1.0
"""Time between two requests for a job if the service names none."""


class Client:
    """A client of one service; use it as a context manager, from one thread.

    Parameters
    ----------
    url : str, optional
        Address of the service, with the path prefix of a proxy if it has one; by default ``PCDNF_URL`` of the
        environment, else ``http://127.0.0.1:8000``. Certificates are always verified; ``SSL_CERT_FILE`` names a
        private authority's.
    key : str, optional
        Sent as ``Authorization: Bearer``; by default ``PCDNF_API_KEY`` of the environment.
    patience : float
        Seconds for which a request is repeated while the service is busy (429 or 503, after the pause that
        ``Retry-After`` names) or cannot be reached.
    on_retry : callable, optional
        Called with the error and the seconds of each such pause.

    Raises
    ------
    PcdnfError
        ``bad_url`` or ``bad_key``. Every method also raises :class:`ProblemError` with the service's answer, and
        :class:`UnreachableError`.
    """

    def __init__(
        self,
        url: str | None = None,
        *,
        key: str | None = None,
        patience: float = PATIENCE_SECONDS,
        on_retry: Notify | None = None,
    ) -> None:
        key = key or os.environ.get("PCDNF_API_KEY")
        self.has_key = bool(key)
        self._session = Session(url or os.environ.get("PCDNF_URL") or DEFAULT_URL, key, patience, on_retry)
        self.url = self._session.url

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._session.close()

    def submit(
        self,
        path: str | os.PathLike[str],
        parameters: Mapping[str, str | int | float] | None = None,
        *,
        progress: BytesDone | None = None,
        idempotency_key: str | None = None,
    ) -> Job:
        """Upload a cloud and queue it.

        Parameters
        ----------
        path : path-like
            The file is streamed, whatever its size.
        parameters : mapping, optional
            Parameters of ``POST /denoise``, see ``docs/api.md``; the service checks them.
        progress : callable, optional
            Called with the bytes read so far and the size of the file.
        idempotency_key : str, optional
            Use the same key to repeat a submission; by default a new key, used for every attempt of this call.

        Returns
        -------
        Job
        """
        path = Path(path)
        headers = {
            "Idempotency-Key": idempotency_key or secrets.token_hex(16),
            "Content-Type": f"multipart/form-data; boundary={secrets.token_hex(16)}",  # the same in every attempt
        }
        try:
            with path.open("rb") as file:
                files = {"file": (path.name, CountedFile(file, progress))}
                response = self._session.send(
                    "POST",
                    "denoise",
                    params=dict(parameters or {}),
                    files=files,
                    headers=headers,
                    timeout=LONG_TIMEOUT,
                )
        except OSError as error:
            raise PcdnfError(
                f"{path} cannot be read: {error.strerror or type(error).__name__}.",
                code="unreadable_file",
                hint="Check the path and its permissions.",
            ) from error
        return Job.model_validate_json(response.content)

    def job(self, job_id: str) -> Job:
        """Return a job as it is now."""
        return Job.model_validate_json(self._session.send("GET", _path(job_id)).content)

    def wait(self, job_id: str, *, progress: Callable[[Job], None] | None = None, timeout: float | None = None) -> Job:
        """Wait until a job has ended, successfully or not.

        Parameters
        ----------
        job_id : str
        progress : callable, optional
            Called with the job after every request; the service's ``Retry-After`` sets the pace.
        timeout : float, optional
            Seconds.

        Returns
        -------
        Job

        Raises
        ------
        TimeoutError
            The job has not ended in time; it keeps running.
        """
        deadline = None if timeout is None else time.monotonic() + timeout
        headers: dict[str, str] = {}
        job: Job | None = None
        while True:
            response = self._session.send("GET", _path(job_id), headers=headers)
            if job is None or response.status_code != 304:
                job = Job.model_validate_json(response.content)
            if progress:
                progress(job)
            if not job.live:
                return job
            headers = {"If-None-Match": response.headers["etag"]} if "etag" in response.headers else {}
            pause = retry_after(response)
            pause = _POLL_SECONDS if pause is None else pause
            if deadline is not None and time.monotonic() + pause > deadline:
                raise TimeoutError(f"Job {job_id} did not end within {timeout:g} seconds.")
            time.sleep(pause)

    def result(
        self,
        job_id: str,
        path: str | os.PathLike[str],
        *,
        format: str | None = None,
        progress: BytesDone | None = None,
    ) -> None:
        """Download a result; ``path`` is replaced in one step after the digest has been checked.

        Parameters
        ----------
        job_id : str
        path : path-like
        format : str, optional
            A name of :data:`pcdnf.file_formats.FORMATS`; by default the one that was uploaded.
        progress : callable, optional
            Called with the bytes received so far and the total.

        Raises
        ------
        PcdnfError
            ``unwritable_file``, ``digest_mismatch``.
        """
        params = {} if format is None else {"format": format}
        try:
            with replacing(path) as file:
                download = Download(file, progress)
                self._session.fetch(f"{_path(job_id)}/result", params, download)
                download.check()
        except OSError as error:
            raise PcdnfError(
                f"{path} cannot be written: {error.strerror or type(error).__name__}.",
                code="unwritable_file",
                hint="Check the folder's permissions and the free disk space.",
            ) from error

    def denoise(
        self, path: str | os.PathLike[str], output: str | os.PathLike[str], **parameters: str | int | float
    ) -> Job:
        """Submit a cloud, wait for its job and download the result, in the format of ``output``'s extension.

        Raises
        ------
        JobError
            The job failed or was cancelled.
        """
        job = self.wait(self.submit(path, parameters).id)
        self.succeeded(job)
        self.result(job.id, output, format=format_of(output, path))
        return job

    @staticmethod
    def succeeded(job: Job) -> None:
        """Raise :class:`JobError` unless a finished job has a result."""
        if job.status == "succeeded":
            return
        reported = job.problem or ProblemDetail(
            detail=f"The job is {job.status}." if job.live else f"The job was {job.status}.",
            code=f"job_{job.status}",
            hint=None if job.live else "Submit the file again.",
        )
        raise JobError(reported, job.id)

    def jobs(self, most: int | None = None) -> Iterator[Job]:
        """Iterate over your jobs, newest first, fetched a page at a time."""
        before: dict[str, str] = {}
        while most is None or most > 0:
            limit = PAGE if most is None else min(most, PAGE)
            response = self._session.send("GET", "jobs", params={"limit": str(limit)} | before)
            page = [Job.model_validate(entry) for entry in response.json()]
            yield from page
            if len(page) < limit:
                return
            most = None if most is None else most - limit
            before = {"before": page[-1].id}

    def cancel(self, job_id: str) -> Job:
        """Cancel a live job. A result is never removed.

        Returns
        -------
        Job
            ``cancelling`` while its worker stops, else ``cancelled``.

        Raises
        ------
        ProblemError
            ``already_finished`` if the job succeeded or failed before.
        """
        return Job.model_validate_json(self._session.send("POST", f"{_path(job_id)}/cancel").content)

    def remove(self, job_id: str) -> Job | None:
        """Remove a finished job with its files, or cancel a live one and remove its upload.

        Returns
        -------
        Job or None
            A job that was live, ``cancelling`` while its worker stops; None if the job is gone.
        """
        response = self._session.send("DELETE", _path(job_id))
        return Job.model_validate_json(response.content) if response.content else None

    def models(self) -> list[Model]:
        """List the models that jobs may name."""
        return [Model.model_validate(entry) for entry in self._session.send("GET", "models").json()]


def format_of(output: str | os.PathLike[str], source: str | os.PathLike[str] | None) -> str | None:
    """Return the format of a result's file name; None keeps the uploaded format if both names end alike."""
    ending = Path(output).suffix.lower()
    return None if source is not None and ending == Path(source).suffix.lower() else SUFFIXES.get(ending)


def _path(job_id: str) -> str:
    if not job_id.isascii() or not job_id.replace("-", "").replace("_", "").isalnum():
        raise PcdnfError(
            f"{job_id!r} is not a valid job id.", code="bad_job_id", hint="List the ids with `pcdnf jobs`."
        )
    return f"jobs/{job_id}"
