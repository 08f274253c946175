"""The settings: every ``PCDNF_*`` variable with its default, its unit and its meaning.

``docs/settings.md`` is written from this class by ``python -m service.settings_page``; a test compares the two.
"""

from __future__ import annotations

import re
import socket
from pathlib import Path
from typing import Literal

from pydantic import Field, field_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

MIB = 1024 * 1024


class SettingsError(Exception):
    """Settings that the service cannot run with; the text says what to set."""


class Settings(BaseSettings):
    """The settings of the service, read from the environment with the prefix ``PCDNF_``."""

    model_config = SettingsConfigDict(
        env_prefix="PCDNF_",
        env_ignore_empty=True,
        extra="ignore",
        hide_input_in_errors=True,  # a URL has a password
    )

    host: str = Field(
        "127.0.0.1",
        description="Address to listen on. An address other than a loopback address requires a key "
        "or PCDNF_ALLOW_ANONYMOUS.",
    )
    port: int = Field(8000, ge=0, le=65535, description="Port to listen on. 0 chooses a free port.")
    api_key: str | None = Field(
        None, min_length=16, description="A single key. Callers send it as `Authorization: Bearer <key>`."
    )
    api_keys_file: Path | None = Field(
        None,
        description="File of named keys. Each line is `name:sha256-of-the-key-in-hex`, and `#` starts a comment. "
        "The file is read again when it changes. A job is visible only to the key that created it.",
    )
    allow_anonymous: bool = Field(
        False,
        description="Serve without keys on an address that is not a loopback address, behind a proxy "
        "that authenticates callers.",
    )

    allowed_origins: str = Field(
        "",
        description="Web pages of other sites that may use the API from a browser (CORS), with commas between them: "
        "`https://app.example.org`. Requires keys. Empty: none.",
    )
    callback_hosts: str = Field(
        "",
        description="Hosts to which jobs may send a message when they end (`callback_url`), with commas between them. "
        "Empty: no callbacks.",
    )
    callback_secret: str | None = Field(
        None,
        min_length=32,
        description="Secret with which callbacks are signed. The receivers have it, too. Required with "
        "PCDNF_CALLBACK_HOSTS.",
    )

    data_dir: Path = Field(
        Path("data"),
        description="Folder for uploads, tiles, results and the SQLite database, on a local disk. If "
        "PCDNF_STORAGE_URL is a bucket, it holds files only until they are uploaded.",
    )
    storage_url: str | None = Field(
        None,
        description="Storage of uploads, tiles and results. Empty: PCDNF_DATA_DIR. For several machines: "
        "`s3://bucket/prefix`, with the endpoint and keys in the usual `AWS_*` variables, or `file:///folder`, "
        "a folder that all machines mount.",
    )
    database_url: str | None = Field(
        None,
        description="SQLAlchemy URL of the job database. Empty: SQLite in PCDNF_DATA_DIR. For several machines: "
        "`postgresql://user:password@host/name`.",
    )
    min_free_bytes: int = Field(
        256 * MIB,
        ge=0,
        description="Free disk space to keep, in bytes. Below it, results expire early. If that does not free enough, "
        "the service is not ready and takes no uploads.",
    )
    disk_budget_bytes: int = Field(
        0,
        ge=0,
        description="Disk space in bytes for all uploads, tiles and results. Above it, the oldest results of the key "
        "that uses most expire early. If that does not free enough, uploads are answered with 503. 0: no budget.",
    )

    max_upload_bytes: int = Field(512 * MIB, ge=1, description="Largest upload in bytes.")
    max_inflated_bytes: int = Field(
        4096 * MIB, ge=1, description="Largest size in bytes of the arrays of a compressed NPZ after decompression."
    )
    max_points: int = Field(10_000_000, ge=1, description="Largest number of points in a cloud.")
    max_iterations: int = Field(4, ge=1, description="Largest number of passes of a job, also for `iterations=auto`.")
    upload_deadline: float = Field(900.0, gt=0, description="Seconds within which an upload must arrive.")
    upload_min_rate: int = Field(
        1024, ge=0, description="Slowest average speed of an upload in bytes per second, after the first ten seconds."
    )
    check_seconds: float = Field(
        60.0, gt=0, description="Seconds the check of an upload may take in its child process."
    )
    check_memory_bytes: int = Field(
        2048 * MIB,
        ge=256 * MIB,
        description="Memory in bytes for the child process that checks an upload.",
    )
    concurrent_checks: int = Field(2, ge=1, description="Number of uploads checked at the same time.")
    max_requests: int = Field(
        256, ge=1, description="Number of requests served at the same time. Further requests are answered with 503."
    )
    max_connections: int = Field(
        512,
        ge=1,
        description="Number of open connections. Above it, the connection that has been idle longest is closed. "
        "Set it below the limit of open files.",
    )
    header_seconds: float = Field(
        10.0,
        gt=0,
        description="Seconds within which the headers of a request must arrive. After that it is answered with 408.",
    )
    send_seconds: float = Field(
        60.0,
        gt=0,
        description="Seconds after which a connection is closed if its caller reads nothing of the response.",
    )
    max_wait_seconds: int = Field(
        60,
        ge=0,
        description="Longest time in seconds that `Prefer: wait=N` holds a request. A larger N is reduced to it.",
    )
    max_streams: int = Field(
        64,
        ge=0,
        description="Number of requests that wait for jobs at the same time, with `Prefer: wait` or as a stream of "
        "events. Above it, `Prefer` is ignored and streams are answered with 503.",
    )

    max_queued_points: int = Field(
        100_000_000,
        ge=1,
        description="Largest queue, in points times iterations that all unfinished jobs still have to do.",
    )
    max_queued_bytes: int = Field(
        8192 * MIB, ge=1, description="Largest total size of the uploads of all unfinished jobs, in bytes."
    )
    max_caller_points: int = Field(
        50_000_000, ge=1, description="Part of the queue that one key may fill, in points times iterations."
    )
    max_caller_bytes: int = Field(
        4096 * MIB, ge=1, description="Largest total size of the uploads of one key's unfinished jobs, in bytes."
    )
    max_caller_jobs: int = Field(1000, ge=1, description="Largest number of unfinished jobs of one key.")
    caller_requests_per_minute: int = Field(
        12_000,
        ge=0,
        description="Number of requests per minute that one key may send to each API process. 0: no limit.",
    )

    device: str = Field(
        "auto",
        description="`auto` (a GPU if there is one, otherwise the CPU), `cpu` or `cuda:N`.",
    )
    require_gpu: bool = Field(False, description="Refuse to start if there is no GPU, in place of using the CPU.")
    precision: Literal["auto", "float32", "bfloat16"] = Field(
        "auto", description="Floating-point format of the network: `auto`, `float32` or `bfloat16`."
    )
    threads: int = Field(
        0, ge=0, le=1024, description="Number of CPU threads of the worker. 0: one for each core that it may run on."
    )
    default_model: str = Field("pcdnf-lite", description="Model of the jobs that name none.")
    tile_points: int = Field(
        16_384,
        ge=256,
        description="Number of points in a tile, the unit of work that is checkpointed. A tile should take some "
        "seconds.",
    )

    worker_id: str | None = Field(
        None,
        description="Name of the worker. Two running workers must not have the same name. Default: `worker-0` on "
        "SQLite, `<host name>-0` on PostgreSQL.",
    )
    heartbeat_seconds: float = Field(5.0, gt=0, description="Seconds between two heartbeats of a worker.")
    worker_stale_seconds: float = Field(
        60.0, gt=0, description="Seconds without a heartbeat after which other workers take over the jobs of a worker."
    )
    poll_seconds: float = Field(0.5, gt=0, description="Seconds between two queries of a worker for new jobs.")
    job_ttl: float = Field(24 * 3600.0, gt=0, description="Seconds for which a finished job and its files are kept.")
    grace_seconds: float = Field(
        30.0, gt=0, description="Seconds that running requests and tiles get to finish after SIGTERM."
    )
    log_level: Literal["debug", "info", "warning", "error"] = Field(
        "info", description="Lowest level that is logged: `debug`, `info`, `warning` or `error`."
    )
    log_format: Literal["text", "json"] = Field(
        "text", description="Format of the log: `text`, or `json` with one object per line."
    )

    @field_validator("device")
    @classmethod
    def _known_device(cls, value: str) -> str:
        if not re.fullmatch(r"auto|cpu|cuda:\d{1,3}", value, re.ASCII):
            raise ValueError("must be auto, cpu or cuda:N, such as cuda:0")
        return value

    @field_validator("allowed_origins")
    @classmethod
    def _plain_origins(cls, value: str) -> str:
        for origin in parts_of(value):
            if not re.fullmatch(r"https?://[a-z0-9.-]+(:\d{1,5})?", origin, re.ASCII):
                raise ValueError("must be origins such as https://app.example.org, with commas between them")
        return value

    @field_validator("callback_hosts")
    @classmethod
    def _plain_hosts(cls, value: str) -> str:
        for host in parts_of(value):
            if not re.fullmatch(r"[a-z0-9-]+(\.[a-z0-9-]+)+", host, re.ASCII):
                raise ValueError("must be host names such as hooks.example.org, with commas between them")
        return value

    @field_validator("worker_id")
    @classmethod
    def _plain_name(cls, value: str | None) -> str | None:
        if value is not None and not re.fullmatch(r"[A-Za-z0-9._-]{1,64}", value):
            raise ValueError("must have 1 to 64 letters, digits, points, hyphens or underscores")
        return value

    @field_validator("database_url")
    @classmethod
    def _known_database(cls, value: str | None) -> str | None:
        if value is not None and not value.startswith(("sqlite:///", "postgresql://", "postgresql+psycopg://")):
            raise ValueError("must be sqlite:///path or postgresql://user:password@host/name")
        return value

    @field_validator("storage_url")
    @classmethod
    def _known_storage(cls, value: str | None) -> str | None:
        if value is not None and not re.match(r"s3://[^/]|file:///.", value):
            raise ValueError("must be s3://bucket/prefix or file:///folder")
        return value

    @property
    def resolved_database_url(self) -> str:
        """The database URL in force, with the default filled in."""
        if self.database_url is None:
            return f"sqlite:///{self.data_dir.absolute() / 'pcdnf.sqlite'}"
        return self.database_url.replace("postgresql://", "postgresql+psycopg://", 1)

    @property
    def upload_limit(self) -> int:
        """Largest upload in bytes that can be accepted: also the queue and the part of one key must hold it."""
        return min(self.max_upload_bytes, self.max_queued_bytes, self.max_caller_bytes)

    @property
    def executor_id(self) -> str:
        """The stable name of this worker's slot."""
        if self.worker_id is not None:
            return self.worker_id
        return "worker-0" if self.resolved_database_url.startswith("sqlite") else f"{socket.gethostname()}-0"

    @property
    def ready_stale_seconds(self) -> float:
        """Seconds without a heartbeat after which a worker no longer counts as ready: three missed heartbeats."""
        return 3 * self.heartbeat_seconds

    @property
    def origins(self) -> list[str]:
        """Origins of other sites that may use the API."""
        return parts_of(self.allowed_origins)

    @property
    def callback_host_names(self) -> list[str]:
        """Hosts to which callbacks may go."""
        return parts_of(self.callback_hosts)

    @property
    def has_keys(self) -> bool:
        """Whether callers need a key."""
        return bool(self.api_key or self.api_keys_file)


def parts_of(text: str) -> list[str]:
    """Return the values of a list with commas between them, in lower case."""
    return [part.strip().lower() for part in text.split(",") if part.strip()]
