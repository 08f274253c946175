"""Settings as data: every ``PCDNF_*`` variable, its default, its unit and what it is for.

``docs/settings.md`` is written from this class by ``python -m service.settings``; a test compares the two.
"""

from __future__ import annotations

import ipaddress
import re
import socket
from pathlib import Path
from typing import Literal

from pydantic import Field, field_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

MIB = 1024 * 1024


class SettingsError(Exception):
    """A combination of settings that cannot be served; the text says what to set."""


class Settings(BaseSettings):
    """What the service reads from its environment. Every name below is prefixed with ``PCDNF_``."""

    model_config = SettingsConfigDict(
        env_prefix="PCDNF_",
        env_ignore_empty=True,
        extra="ignore",
        hide_input_in_errors=True,  # a URL has a password
    )

    host: str = Field(
        "127.0.0.1",
        description="Address to listen on. Anything but a loopback address needs a key, or PCDNF_ALLOW_ANONYMOUS.",
    )
    port: int = Field(8000, ge=0, le=65535, description="Port to listen on; 0 picks a free one.")
    api_key: str | None = Field(
        None, min_length=16, description="One key that callers send as `Authorization: Bearer <key>`."
    )
    api_keys_file: Path | None = Field(
        None,
        description="File of named keys, one `name:sha256-of-the-key-in-hex` a line, `#` starts a comment. "
        "Read again when it changes. A job is visible only to the key that made it.",
    )
    allow_anonymous: bool = Field(
        False,
        description="Serve without a key on an address that is not loopback (behind a proxy that authenticates).",
    )

    data_dir: Path = Field(
        Path("data"),
        description="Folder of uploads, tiles, results and the SQLite file. Local disk only. Where PCDNF_STORAGE_URL "
        "is a bucket, of files on their way there.",
    )
    storage_url: str | None = Field(
        None,
        description="Where uploads, tiles and results lie: empty for PCDNF_DATA_DIR, or for several machines "
        "`s3://bucket/prefix` (endpoint and keys in the usual `AWS_*` variables) or `file:///folder` that all of them "
        "mount.",
    )
    database_url: str | None = Field(
        None,
        description="SQLAlchemy URL of the job database: empty for SQLite in PCDNF_DATA_DIR, or "
        "`postgresql://user:password@host/name` to share the queue between machines.",
    )
    min_free_bytes: int = Field(
        256 * MIB,
        ge=0,
        description="Free disk space in bytes below which results expire early; where that is not enough, "
        "the service is not ready and takes no upload.",
    )
    disk_budget_bytes: int = Field(
        0,
        ge=0,
        description="Bytes that uploads, tiles and results may take together; beyond it the oldest results of the "
        "key that has most expire early, and where that is not enough uploads are answered 503. 0: as much as there is "
        "room for.",
    )

    max_upload_bytes: int = Field(512 * MIB, ge=1, description="Largest request body in bytes.")
    max_inflated_bytes: int = Field(
        4096 * MIB, ge=1, description="Most bytes that the arrays of a compressed NPZ may inflate to."
    )
    max_points: int = Field(10_000_000, ge=1, description="Most points in one cloud.")
    max_iterations: int = Field(4, ge=1, description="Most passes of a job; `iterations=auto` chooses no more.")
    upload_deadline: float = Field(900.0, gt=0, description="Seconds in which a request body has to arrive.")
    upload_min_rate: int = Field(
        1024, ge=0, description="Slowest upload in bytes per second, averaged, after the first ten seconds."
    )
    check_seconds: float = Field(
        60.0, gt=0, description="Seconds the check of an upload may take in its child process."
    )
    check_memory_bytes: int = Field(
        2048 * MIB,
        ge=256 * MIB,
        description="Memory in bytes the check of an upload may take in its child process.",
    )
    concurrent_checks: int = Field(2, ge=1, description="Uploads checked at the same time.")
    max_requests: int = Field(256, ge=1, description="Requests served at the same time; more are answered 503.")
    max_connections: int = Field(
        512,
        ge=1,
        description="Open connections at the same time; beyond it the one that has been idle longest is closed. "
        "Keep it below the limit of open files.",
    )
    header_seconds: float = Field(
        10.0, gt=0, description="Seconds in which the headers of a request have to arrive; later ones are answered 408."
    )
    send_seconds: float = Field(
        60.0, gt=0, description="Seconds after which a connection is closed whose caller takes nothing of its answer."
    )
    max_wait_seconds: int = Field(
        60, ge=0, description="Longest time in seconds that `Prefer: wait=N` holds a request; N above it is cut to it."
    )
    max_streams: int = Field(
        64,
        ge=0,
        description="Requests that wait for jobs at the same time, by `Prefer: wait` or as a stream of events; beyond "
        "it `Prefer` is ignored and streams are answered 503.",
    )

    max_queued_points: int = Field(
        100_000_000, ge=1, description="Most points times iterations still to do in all unfinished jobs together."
    )
    max_queued_bytes: int = Field(
        8192 * MIB, ge=1, description="Most bytes of uploads of all unfinished jobs together."
    )
    max_caller_points: int = Field(
        50_000_000, ge=1, description="Most points times iterations still to do in the unfinished jobs of one key."
    )
    max_caller_bytes: int = Field(
        4096 * MIB, ge=1, description="Most bytes of the uploads of one key's unfinished jobs."
    )
    max_caller_jobs: int = Field(1000, ge=1, description="Most unfinished jobs of one key.")
    caller_requests_per_minute: int = Field(
        12_000,
        ge=0,
        description="Requests one key may send in a minute, to each API process; 0 for no limit.",
    )

    device: str = Field(
        "auto",
        pattern=r"^(auto|cpu|cuda:\d{1,3})$",
        description="`auto` (CUDA when there is one, else the CPU), `cpu` or `cuda:N`.",
    )
    require_gpu: bool = Field(False, description="Refuse to start rather than fall back to the CPU.")
    precision: Literal["auto", "float32", "bfloat16"] = Field(
        "auto", description="Arithmetic of the network: `auto`, `float32` or `bfloat16`."
    )
    threads: int = Field(0, ge=0, le=1024, description="CPU threads of the worker; 0 uses every core it may run on.")
    default_model: str = Field("pcdnf-lite", description="Model of a job that names none.")
    tile_points: int = Field(
        16_384,
        ge=256,
        description="Points of one tile, the unit of work that is checkpointed. A tile should take some seconds.",
    )

    worker_id: str | None = Field(
        None,
        pattern=r"^[A-Za-z0-9._-]{1,64}$",
        description="Name of the worker's slot, one live process each. Default: `worker-0` on SQLite, "
        "`<host name>-0` otherwise.",
    )
    heartbeat_seconds: float = Field(5.0, gt=0, description="Seconds between two signs of life of a worker.")
    worker_stale_seconds: float = Field(
        60.0, gt=0, description="Silence in seconds after which another worker takes a worker's jobs over."
    )
    poll_seconds: float = Field(0.5, gt=0, description="Seconds between two looks of a worker at the queue.")
    job_ttl: float = Field(24 * 3600.0, gt=0, description="Seconds that a finished job and its files are kept.")
    grace_seconds: float = Field(
        30.0, gt=0, description="Seconds that requests and the running tile get to finish after SIGTERM."
    )
    log_level: Literal["debug", "info", "warning", "error"] = Field("info", description="Least severe log line shown.")
    log_format: Literal["text", "json"] = Field(
        "text", description="Lines of the log: `text` for people, or `json`, an object a line, for programs."
    )

    @field_validator("database_url")
    @classmethod
    def _known_database(cls, value: str | None) -> str | None:
        if value is not None and not value.startswith(("sqlite:///", "postgresql://", "postgresql+psycopg://")):
            raise ValueError("use sqlite:///path or postgresql://user:password@host/name")
        return value

    @field_validator("storage_url")
    @classmethod
    def _known_storage(cls, value: str | None) -> str | None:
        if value is not None and not re.match(r"s3://[^/]|file:///.", value):
            raise ValueError("use s3://bucket/prefix or file:///folder")
        return value

    @property
    def resolved_database_url(self) -> str:
        """The database URL in force, with the default filled in."""
        if self.database_url is None:
            return f"sqlite:///{self.data_dir.absolute() / 'pcdnf.sqlite'}"
        return self.database_url.replace("postgresql://", "postgresql+psycopg://", 1)

    @property
    def executor_id(self) -> str:
        """The stable name of this worker's slot."""
        if self.worker_id is not None:
            return self.worker_id
        return "worker-0" if self.resolved_database_url.startswith("sqlite") else f"{socket.gethostname()}-0"

    @property
    def ready_stale_seconds(self) -> float:
        """Silence after which a worker no longer counts for readiness: three missed signs of life."""
        return 3 * self.heartbeat_seconds

    def check_exposure(self) -> None:
        """Raise :class:`SettingsError` where the service would be open to the network without a key."""
        if is_loopback(self.host) or self.allow_anonymous or self.api_key or self.api_keys_file:
            return
        raise SettingsError(
            f"Refusing to listen on {self.host} without a key. Set PCDNF_API_KEY or PCDNF_API_KEYS_FILE, listen on "
            "127.0.0.1, or set PCDNF_ALLOW_ANONYMOUS=true if something in front of the service authenticates callers."
        )


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach `host`."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def settings_table() -> str:
    """Return the Markdown of ``docs/settings.md``."""
    rows = [
        "# Settings",
        "",
        "The service reads its settings from the environment. This page is written from `service/settings.py` by",
        "`python -m service.settings > docs/settings.md`.",
        "",
        "| Variable | Default | Meaning |",
        "|---|---|---|",
    ]
    for name, field in Settings.model_fields.items():
        default = "" if field.default is None else f"`{_shown(field.default)}`"
        rows.append(f"| `PCDNF_{name.upper()}` | {default} | {field.description} |")
    return "\n".join(rows) + "\n"


def _shown(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    print(settings_table(), end="")
