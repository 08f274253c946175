"""The commands that talk to a service: submit, jobs. They need the extra ``client``, imported when one runs."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from ..errors import PcdnfError

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..client import Client, Job
    from .batch import Batch, Item
    from .progress import Display

    Subparsers = argparse._SubParsersAction[argparse.ArgumentParser]

FAILED, INTERRUPTED = 1, 130
PARAMETERS = {
    "iterations": "number of passes over the cloud: auto, or a number",
    "radius": "patch radius: auto, a length, or a percentage of the diagonal such as 4%%",
    "fast": "half as many neighbours per point: true or false",
    "model": "name listed by the service's /models",
    "seed": "seed of all random choices",
    "normals": "initial normals: auto, pca or input",
    "orient": "flip the normals to one side of the surface: true or false",
    "outliers": "points that belong to no surface: keep, drop or mark (a column outlier)",
    "sensor": "where the scanner stood: x,y,z",
    "nonfinite": "rows that contain NaN or infinity: keep, reject or drop",
    "diagnostics": "add displacement, estimated noise and confidence of each point to the result: true or false",
    "ignore_classes": "LAS classes that are returned unchanged and excluded from the fit, such as 7,18",
    "coordinates": "type of the result's coordinates: keep, float32 or float64",
    "callback_url": "address that the service sends a signed message to when the job has ended",
}
"""Parameters of a job. The service checks them and chooses those that are omitted."""
DEFAULT_PATIENCE = 600.0
SHOWN_JOBS = 20
_LOOPBACK = ("localhost", "127.0.0.1", "::1")


def add_submit(subparsers: Subparsers) -> None:
    """Add the command ``submit``."""
    parser = subparsers.add_parser(
        "submit",
        help="denoise files on a service",
        description="Upload files to a service, wait for their jobs and download the results. Ctrl-C asks whether to "
        "cancel the jobs or leave them running; without a terminal they keep running.",
        epilog="Exit status: 0 all files are done; 1 some failed; 2 wrong usage, nothing was sent; 130 interrupted.",
    )
    parser.add_argument("files", nargs="*", metavar="FILE", help="files, or patterns such as 'scans/**/*.ply'")
    where = parser.add_mutually_exclusive_group()
    where.add_argument("-o", "--output", type=Path, help="result of a single file; its extension chooses the format")
    where.add_argument("--out-folder", type=Path, metavar="FOLDER", help="folder for results, named FILE_denoised")
    where.add_argument("--detach", action="store_true", help="print the job ids and do not wait")
    parser.add_argument("--resume", action="append", default=[], metavar="ID", help="continue with an earlier job")
    _add_service(parser)
    parser.add_argument("--json", action="store_true", help="print one JSON object per file")
    parser.add_argument("--quiet", action="store_true", help="print errors and warnings only")
    group = parser.add_argument_group("parameters of the jobs", "The service checks these and chooses the others.")
    for name, what in PARAMETERS.items():
        group.add_argument(f"--{name.replace('_', '-')}", metavar=name[0].upper(), help=what)
    parser.set_defaults(run=_submit)


def add_jobs(subparsers: Subparsers) -> None:
    """Add the command ``jobs``."""
    parser = subparsers.add_parser(
        "jobs",
        help="list, cancel or remove your jobs on a service",
        description="List your jobs on a service, newest first, or cancel or remove jobs.",
        epilog="Exit status: 0 done; 1 some jobs could not be changed; 2 refused; 130 interrupted.",
    )
    parser.add_argument("--cancel", action="append", default=[], metavar="ID", help="cancel a job; a result is kept")
    parser.add_argument("--remove", action="append", default=[], metavar="ID", help="remove a job with its files")
    parser.add_argument(
        "--limit", type=_count, default=SHOWN_JOBS, metavar="N", help="most jobs listed (default: %(default)s)"
    )
    _add_service(parser)
    parser.add_argument("--json", action="store_true", help="print one JSON object per job")
    parser.set_defaults(run=_jobs)


def _add_service(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--url", help="address of the service (default: PCDNF_URL, then http://127.0.0.1:8000)")
    parser.add_argument("--key-file", type=Path, metavar="FILE", help="file with the API key (default: PCDNF_API_KEY)")
    parser.add_argument(
        "--patience",
        type=float,
        default=DEFAULT_PATIENCE,
        metavar="S",
        help="seconds to keep trying while the service is busy or unreachable (default: %(default)g)",
    )


def _count(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError("must be at least 1")
    return value


def _connect(options: argparse.Namespace, display: Display) -> Client:
    from ..client import Client

    def retried(error: PcdnfError, pause: float) -> None:
        display.note(f"{error} Retrying in {pause:.0f} s.")

    key = None if options.key_file is None else _read_key(options.key_file)
    client = Client(options.url, key=key, patience=options.patience, on_retry=retried)
    parts = urlsplit(client.url)
    if client.has_key and parts.scheme == "http" and parts.hostname not in _LOOPBACK:
        display.note(f"The API key is sent to {parts.hostname} without encryption; use https if possible.")
    return client


def _read_key(path: Path) -> str:
    try:
        key = path.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "it is not text"
        raise PcdnfError(f"The key file cannot be read: {why}.", code="bad_key", hint="Check --key-file.") from None
    if not key:
        raise PcdnfError("The key file is empty.", code="bad_key", hint="Check --key-file.")
    return key


def _submit(options: argparse.Namespace) -> int:
    if not options.files and not options.resume:
        raise PcdnfError("No files were given.", code="no_files", hint="Name a file, or a job with --resume.")
    if not (options.output or options.out_folder or options.detach):
        raise PcdnfError(
            "No place for the results was given.",
            code="no_output",
            hint="Use -o FILE, --out-folder FOLDER or --detach.",
        )
    if options.detach and options.resume:
        raise PcdnfError("--resume and --detach cannot be combined.", code="usage", hint="Remove one of them.")
    from .batch import Batch, Destination, Item, expanded
    from .progress import choose

    items = [Item(job_id, job_id=job_id) for job_id in options.resume]
    items += [Item(path.name, path) for path in expanded(options.files)]
    destination = None if options.detach else Destination(options.output, options.out_folder)
    if destination is not None:
        destination.check(items)
    display = choose(quiet=options.quiet)
    given = {name: getattr(options, name) for name in PARAMETERS if getattr(options, name) is not None}
    with _connect(options, display) as client:
        batch = Batch(client, display, given, lambda item: _report(item, options, display))
        try:
            if destination is None:
                batch.submit(items)
            else:
                batch.run(items, destination)
        except KeyboardInterrupt:
            display.clear()
            _interrupted(batch, options)
            return INTERRUPTED
    return FAILED if any(item.error for item in items) else 0


def _report(item: Item, options: argparse.Namespace, display: Display) -> None:
    """Print the outcome of a file: results to standard output, sentences to standard error."""
    from .batch import seconds

    if options.json:
        print(json.dumps(item.as_dict()), flush=True)
    for warning in item.job.warnings if item.job else []:
        display.note(f"{item.name}: {warning}")
    if item.error is not None:
        hint = f" {item.error.hint}" if item.error.hint else ""
        job_id = f" Its job is {item.job_id}." if item.job_id and item.error.code == "unreachable" else ""
        display.note(f"{item.name}: {item.error}{hint}{job_id}")
    elif options.json:
        return
    elif options.detach:
        print(item.job_id, flush=True)
    elif not options.quiet and item.job is not None:
        points, took = item.job.upload["points"], seconds(item.job) or 0.0
        how = "" if item.job.execution is None else f", {item.job.execution.model} on {item.job.execution.device}"
        print(f"{item.name}: {points:,} points in {took:.1f} s{how}: {item.output}", flush=True)


def _interrupted(batch: Batch, options: argparse.Namespace) -> None:
    """After Ctrl-C, cancel the jobs that are under way or print how to continue with them."""
    items = list(batch.under_way)
    if batch.uploading is not None:
        print(f"pcdnf: {batch.uploading.name}: the upload was interrupted. If the service received it, `pcdnf "
              "jobs` lists its job.", file=sys.stderr)  # fmt: skip
    if not items:
        print("pcdnf: Interrupted.", file=sys.stderr)
        return
    ids = [str(item.job_id) for item in items]
    if _wants_cancel(ids):
        for item, job_id in zip(items, ids, strict=True):
            try:
                item.job = batch.client.cancel(job_id)
                print(f"pcdnf: {item.name}: cancelled.", file=sys.stderr)
            except PcdnfError as error:
                item.error = error
                print(f"pcdnf: {item.name}: {error}", file=sys.stderr)
    else:
        address = f" --url {options.url}" if options.url else ""
        resume = " ".join(f"--resume {job_id}" for job_id in ids)
        where = f"-o {options.output}" if options.output else f"--out-folder {options.out_folder}"
        print(f"pcdnf: Left running. Continue with: pcdnf submit {resume} {where}{address}", file=sys.stderr)
    if options.json:
        for item in items:
            print(json.dumps(item.as_dict()), flush=True)


def _wants_cancel(ids: list[str]) -> bool:
    """Ask on a terminal; any answer but a clear yes leaves the jobs running."""
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return False
    what = f"job {ids[0]}" if len(ids) == 1 else f"{len(ids)} jobs"
    try:
        print(f"\nInterrupted. Cancel {what}, or leave running? [c/L] ", end="", file=sys.stderr, flush=True)
        return sys.stdin.readline().strip().lower() in ("c", "cancel")
    except KeyboardInterrupt:
        print(file=sys.stderr)
        return False


def _jobs(options: argparse.Namespace) -> int:
    from .progress import Quiet

    display = Quiet()
    failed = False
    with _connect(options, display) as client:
        asked: list[tuple[Callable[[str], Job | None], str]]
        asked = [(client.cancel, job_id) for job_id in options.cancel]
        asked += [(client.remove, job_id) for job_id in options.remove]
        for request, job_id in asked:
            try:
                job = request(job_id)
            except PcdnfError as error:
                failed = True
                display.note(f"{job_id}: {error}{f' {error.hint}' if error.hint else ''}")
                continue
            state = "removed" if job is None else job.status
            print(json.dumps({"id": job_id, "status": state}) if options.json else f"{job_id}  {state}")
        if not asked:
            for job in client.jobs(options.limit):
                print(job.model_dump_json() if options.json else _row(job), flush=True)
    return FAILED if failed else 0


def _row(job: Job) -> str:
    share = job.progress.done / max(job.progress.total, 1)
    made = job.created_at.astimezone().strftime("%Y-%m-%d %H:%M")
    return f"{job.id}  {job.status:<10} {share:>4.0%}  {made}  {job.upload['points']:>12,} points  {job.upload['name']}"
