"""``pcdnf doctor``: check everything the service needs, and say how to repair what is wrong.

It changes nothing: it creates and upgrades no database, and removes the file with which it tests the storage.
"""

from __future__ import annotations

import platform
import shutil
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

import httpx
import sqlalchemy as sa
from sqlalchemy.exc import SQLAlchemyError

import pcdnf
from pcdnf.errors import PcdnfError

from ..api.auth import Keys
from ..api.listener import bind
from ..database.damage import DamageError, check_file, damage_of
from ..database.engine import create_engine
from ..database.migrations import lacking
from ..exposure import check_exposure
from ..jobs import drain_switch
from ..jobs.files import job_file
from ..jobs.job import new_id
from ..settings import Settings, SettingsError
from ..storage.base import StorageError
from ..storage.open import open_storage
from ..telemetry import tracing

Level = Literal["ok", "warning", "problem"]
ANSWER_SECONDS = 3.0
STORAGE_SECONDS = 5.0
MIB = 1024 * 1024
NOT_READY_ADVICE = "If it has just been started, wait a little. Otherwise look at its log."


@dataclass(frozen=True)
class Finding:
    """The result of one check; `advice` says how to repair what is not ok, `code` is stable where there is one."""

    about: str
    level: Level
    text: str
    advice: str | None = None
    code: str | None = None

    def to_json(self) -> dict[str, Any]:
        """Return it as a JSON object."""
        return asdict(self)


def examine(settings: Settings) -> Iterator[Finding]:
    """Run one check after the other."""
    for check in CHECKS:
        yield from check(settings)


def _python(_: Settings) -> Iterator[Finding]:
    yield Finding("python", "ok", f"Python {platform.python_version()}, pcdnf {pcdnf.__version__}")


def _device(settings: Settings) -> Iterator[Finding]:
    import torch

    from pcdnf.inference.device import choose_device, choose_precision

    yield Finding("torch", "ok", f"torch {torch.__version__}")
    if torch.version.cuda is None and shutil.which("nvidia-smi"):
        advice = (
            "Install the CUDA build from PyPI: pip install --force-reinstall torch==" + torch.__version__.split("+")[0]
        )
        yield Finding("torch", "warning", "This machine has the NVIDIA driver, but torch is a CPU build.", advice)
    try:
        device = choose_device(settings.device)
        precision = choose_precision(settings.precision, device=device)
    except PcdnfError as error:
        yield Finding(
            "device", "problem", str(error), f"Set PCDNF_DEVICE to another device. {error.hint or ''}".strip()
        )
        return
    if settings.require_gpu and device == "cpu":
        advice = "Give the worker a CUDA device and install a CUDA build of torch, or unset PCDNF_REQUIRE_GPU."
        yield Finding("device", "problem", "PCDNF_REQUIRE_GPU is set, but there is no GPU.", advice)
        return
    chosen = " (auto: there is no GPU)" if settings.device == "auto" and device == "cpu" else ""
    yield Finding("device", "ok", f"{device}{chosen}, {precision}")


def _weights(settings: Settings) -> Iterator[Finding]:
    from pcdnf.models.catalog import available_models
    from pcdnf.models.checkpoint import load_checkpoint

    names = [model.name for model in available_models()]
    for name in names:
        try:
            info, _ = load_checkpoint(name)
        except PcdnfError as error:
            yield Finding("weights", "problem", str(error), error.hint or "Reinstall pcdnf.")
        else:
            yield Finding("weights", "ok", f"{name}: {info.sha256[:16]}…, unchanged")
    if settings.default_model not in names:
        text = f"There is no model named {settings.default_model!r}."
        yield Finding("weights", "problem", text, f"Set PCDNF_DEFAULT_MODEL to one of {', '.join(names)}.")


def _extras(_: Settings) -> Iterator[Finding]:
    for title, module, extra in (("LAZ", "lazrs", "las"), ("E57", "pye57", "e57")):
        there = find_spec(module) is not None
        text = (
            f"{title} can be read and written" if there else f"{title} is not installed: pip install 'pcdnf[{extra}]'"
        )
        yield Finding("formats", "ok", text)
    if tracing.is_enabled() and not find_spec("opentelemetry.exporter"):
        advice = "Run: pip install 'pcdnf[traces]', or unset OTEL_EXPORTER_OTLP_ENDPOINT."
        yield Finding(
            "traces", "problem", "The environment asks for traces, but their libraries are not installed.", advice
        )


def _data_folder(settings: Settings) -> Iterator[Finding]:
    folder = settings.data_dir.absolute()
    there = next(path for path in (folder, *folder.parents) if path.exists())
    advice = "Make it writable for the user of the service, or set PCDNF_DATA_DIR to another folder."
    try:
        probe = there / f".{new_id()}"
        probe.write_bytes(b"pcdnf")
        probe.unlink()
    except OSError as error:
        yield Finding("data", "problem", f"{there} is not writable: {error.strerror}.", advice, "data_read_only")
        return
    text = f"{folder} is writable" if there == folder else f"{folder} can be created"
    yield Finding("data", "ok", text)
    free, least = shutil.disk_usage(there).free, settings.min_free_bytes
    summary = f"{free // MIB} MiB are free, at least {least // MIB} MiB must stay free"
    if free < least:
        advice = "Free some space, or lower PCDNF_MIN_FREE_BYTES. Until then the service is not ready."
        yield Finding("disk", "problem", f"{summary}.", advice)
    else:
        yield Finding("disk", "ok", summary)


def _storage(settings: Settings) -> Iterator[Finding]:
    if settings.storage_url is None and not settings.data_dir.exists():
        return  # made at the first start
    try:
        storage = open_storage(settings, patience=STORAGE_SECONDS)
        job_id = f"doctor-{new_id()}"
        scratch = storage.scratch()
        scratch.write_bytes(b"pcdnf")
        storage.put(scratch, job_file(job_id, "probe"))
        back = b"".join(storage.read(job_file(job_id, "probe")))
        storage.delete_job(job_id)
        used = storage.used_bytes()
    except (StorageError, SettingsError, OSError) as error:
        advice = "Check PCDNF_STORAGE_URL and, for a bucket, its name, its region and its keys."
        yield Finding("storage", "problem", f"The storage cannot be used: {error}", advice)
        return
    if back != b"pcdnf":
        advice = "Use a storage that returns a file as soon as it is written."
        yield Finding("storage", "problem", "The storage returned other bytes than were written.", advice)
        return
    budget = settings.disk_budget_bytes
    summary = f"jobs use {used // MIB} MiB" + (
        f" of a budget of {budget // MIB} MiB" if budget else ", there is no budget"
    )
    if budget and used > 0.9 * budget:
        advice = "The oldest results will expire early. Raise PCDNF_DISK_BUDGET_BYTES, or lower PCDNF_JOB_TTL."
        yield Finding("storage", "warning", f"{summary}.", advice)
    else:
        yield Finding("storage", "ok", summary)


def _database(settings: Settings) -> Iterator[Finding]:
    url = sa.make_url(settings.resolved_database_url)
    sqlite = url.get_backend_name() == "sqlite"
    name = str(url.database) if sqlite else url.render_as_string(hide_password=True)
    if sqlite and not Path(name).exists():
        yield Finding("database", "ok", f"{name} will be created at the first start")
        return
    try:
        check_file(settings, thorough=True)
    except DamageError as error:
        yield Finding("database", "problem", error.sentence, error.advice, error.code)
        return
    engine = create_engine(settings, busy_seconds=ANSWER_SECONDS)
    try:
        absent = lacking(engine)
        if absent:
            advice = "The next start upgrades it. An upgrade cannot be undone, so make a copy first."
            yield Finding("database", "warning", f"{name} is of an older version, without {absent}.", advice)
            return
        yield Finding("database", "ok", f"{name} answers and is up to date")
        with engine.connect() as connection:
            if drain_switch.is_on(connection, drain_switch.DRAIN):
                yield Finding(
                    "drain",
                    "warning",
                    "The service is draining and takes no new jobs.",
                    "To open it, run: pcdnf drain --off",
                )
    except SQLAlchemyError as error:
        code = damage_of(error)
        if code is not None:
            damage = DamageError(code, name)
            yield Finding("database", "problem", damage.sentence, damage.advice, code)
            return
        text = f"{name} does not answer: {type(error).__name__}."
        yield Finding("database", "problem", text, "Check PCDNF_DATABASE_URL, and whether the server runs.")
    finally:
        engine.dispose()


def _keys(settings: Settings) -> Iterator[Finding]:
    try:
        check_exposure(settings)
        keys = Keys.of(settings)
    except SettingsError as error:
        text, _, advice = str(error).partition(". ")
        yield Finding("keys", "problem", text, advice or "Each of its lines must be name:sha256-of-the-key-in-hex.")
        return
    if keys.required:
        yield Finding("keys", "ok", f"{keys.count} keys are valid")
    elif settings.allow_anonymous:
        advice = "Make sure that a proxy authenticates the callers."
        yield Finding("keys", "warning", f"Anyone who can reach {settings.host} can use the service.", advice)
    else:
        yield Finding("keys", "ok", f"no key is required, because only this machine can reach {settings.host}")


def _service(settings: Settings) -> Iterator[Finding]:
    if settings.port == 0:
        return
    host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(settings.host, settings.host)
    address = f"http://{f'[{host}]' if ':' in host else host}:{settings.port}"
    try:
        answer = httpx.get(f"{address}/readyz", timeout=ANSWER_SECONDS, trust_env=False)
        reported = answer.json()
    except httpx.TransportError:
        yield _port(settings)
        return
    except ValueError:
        reported = None
    if not isinstance(reported, dict) or not {"workers", "code"} & reported.keys():
        advice = "Set PCDNF_PORT or --port to a free port."
        yield Finding("port", "problem", f"Another program answers at {address}.", advice)
    elif answer.status_code == 200:
        yield Finding("service", "ok", f"{address} is ready, with {len(reported['workers'])} workers")
    else:
        yield Finding("service", "problem", f"{address} is not ready: {reported.get('detail')}", NOT_READY_ADVICE)


def _port(settings: Settings) -> Finding:
    try:
        bind(settings).close()
    except SettingsError as error:
        return Finding("port", "problem", f"Port {settings.port} is in use, but no service answers there.", str(error))
    return Finding("port", "ok", f"port {settings.port} of {settings.host} is free, no service is running")


CHECKS: list[Callable[[Settings], Iterator[Finding]]] = [
    _python, _device, _weights, _extras, _data_folder, _storage, _database, _keys, _service,
]  # fmt: skip


def print_finding(finding: Finding) -> None:
    """Print a finding for a person."""
    mark = {"ok": "ok     ", "warning": "warning", "problem": "PROBLEM"}[finding.level]
    print(f"{mark}  {finding.about:<9}{finding.text}", flush=True)
    if finding.advice:
        print(f"{'':18}{finding.advice}", flush=True)
