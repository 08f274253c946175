"""Storage in a bucket, through the S3 protocol, for several machines that share the work.

A file is written to a local folder first and then uploaded in parts. It is read in parts as well. Each part is a
request of its own, which is repeated if it fails. The endpoint and the keys come from the usual ``AWS_*`` variables.
"""

from __future__ import annotations

import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path

import obstore
from obstore.exceptions import BaseError
from obstore.store import S3Store

from .base import StorageError, clear, folder_bytes

PART_BYTES = 8 * 1024 * 1024
PARTS_AT_ONCE = 4
REQUEST_SECONDS = 120.0  # for one part


class BucketStorage:
    """Objects below a prefix of a bucket.

    Parameters
    ----------
    url : str
        ``s3://bucket/prefix``.
    folder : Path
        Folder of local files while they are written or read; created if missing.
    patience : float
        Seconds that a request is tried again.

    Raises
    ------
    StorageError
        Here if the ``AWS_*`` variables make no sense, and in every method if the bucket does not answer.
    """

    frees_disk = False

    def __init__(self, url: str, folder: Path, *, patience: float) -> None:
        bucket, _, prefix = url.removeprefix("s3://").partition("/")
        with _explained():
            self._store = S3Store(
                bucket,
                prefix=prefix.strip("/") or None,
                # Without TLS only if the URL of the endpoint says so.
                client_options={"allow_http": True, "timeout": timedelta(seconds=REQUEST_SECONDS)},
                retry_config={"retry_timeout": timedelta(seconds=patience)},
            )
        self._scratch = folder / "scratch"
        self._scratch.mkdir(parents=True, exist_ok=True)

    def scratch(self) -> Path:
        """See :class:`service.storage.base.Storage`."""
        return self._scratch / uuid.uuid4().hex

    def put(self, source: Path, name: str) -> None:
        """See :class:`service.storage.base.Storage`."""
        try:
            with _explained():
                obstore.put(self._store, name, source, chunk_size=PART_BYTES, max_concurrency=PARTS_AT_ONCE)
        finally:
            source.unlink()

    @contextmanager
    def reading(self, name: str) -> Iterator[Path]:
        """See :class:`service.storage.base.Storage`."""
        path = self.scratch()
        try:
            with path.open("wb") as file:
                file.writelines(self.read(name))
            yield path
        finally:
            path.unlink()

    def read(self, name: str, start: int = 0, stop: int | None = None) -> Iterator[bytes]:
        """See :class:`service.storage.base.Storage`."""
        size = self.size(name)
        return self._parts(name, start, size if stop is None else stop)

    def _parts(self, name: str, start: int, stop: int) -> Iterator[bytes]:
        for first in range(start, stop, PART_BYTES):
            with _explained():
                part = obstore.get_range(self._store, name, start=first, end=min(first + PART_BYTES, stop))
            yield bytes(part)

    def size(self, name: str) -> int:
        """See :class:`service.storage.base.Storage`."""
        with _explained():
            return obstore.head(self._store, name)["size"]

    def delete_job(self, job_id: str, *, keep: frozenset[str] = frozenset()) -> None:
        """See :class:`service.storage.base.Storage`."""
        folder = f"jobs/{job_id}/"
        names = [name for name, _, _ in self._list(folder) if name.removeprefix(folder).split("/")[0] not in keep]
        if names:
            with _explained():
                obstore.delete(self._store, names)

    def job_ids(self) -> list[str]:
        """See :class:`service.storage.base.Storage`."""
        with _explained():
            found = obstore.list_with_delimiter(self._store, "jobs/")["common_prefixes"]
        return [prefix.rstrip("/").rpartition("/")[2] for prefix in found]

    def idle_seconds(self, job_id: str) -> float:
        """See :class:`service.storage.base.Storage`."""
        now = datetime.now(UTC)
        return min(((now - written).total_seconds() for _, _, written in self._list(f"jobs/{job_id}/")), default=0.0)

    def clear_scratch(self, older_than: float) -> None:
        """See :class:`service.storage.base.Storage`."""
        clear(self._scratch, older_than)

    def free_bytes(self) -> int:
        """See :class:`service.storage.base.Storage`."""
        return shutil.disk_usage(self._scratch).free

    def used_bytes(self) -> int:
        """See :class:`service.storage.base.Storage`."""
        return sum(size for _, size, _ in self._list("jobs/")) + folder_bytes(self._scratch)

    def job_bytes(self, job_id: str) -> int:
        """See :class:`service.storage.base.Storage`."""
        return sum(size for _, size, _ in self._list(f"jobs/{job_id}/"))

    def check(self) -> None:
        """See :class:`service.storage.base.Storage`."""
        for _ in self._list("nothing/"):
            break

    def _list(self, prefix: str) -> Iterator[tuple[str, int, datetime]]:
        """Yield name, bytes and time of the objects below a prefix."""
        with _explained():
            for batch in obstore.list(self._store, prefix, chunk_size=1000):
                for found in batch:
                    yield found["path"], found["size"], found["last_modified"]


@contextmanager
def _explained() -> Iterator[None]:
    """Raise the library's errors as ours; its FileNotFoundError is Python's own."""
    try:
        yield
    except BaseError as error:
        raise StorageError(" ".join(str(error).partition("Debug source")[0].split())) from error
