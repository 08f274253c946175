"""A result over HTTP: its format, range, file name and digest (RFC 9110, RFC 9530)."""

from __future__ import annotations

import base64
import re
from email.utils import formatdate
from urllib.parse import quote

from fastapi import Request, Response
from fastapi.responses import StreamingResponse

from pcdnf.file_formats import FORMATS, available

from ...jobs.files import DISPLAY, job_file, result_file
from ...jobs.job import Job
from ...problems import Problem, job_expired
from ...storage.base import Storage

MEDIA_TYPES = {name: FORMATS[name].media_type for name in available()}
_RANGE = re.compile(r"^bytes=(\d{0,18})-(\d{0,18})$", re.ASCII)  # no file is longer


def chosen_format(request: Request, job: Job, format_: str | None) -> str:
    """Return the format to answer with: `format_`, else by ``Accept``, else the one that came in.

    Raises
    ------
    Problem
        406 where it is none that can be written here.
    """
    name = format_ or _accepted(request.headers.get("accept", "*/*"), job.upload["format"])
    if name is None or name not in MEDIA_TYPES:
        raise Problem(
            "not_acceptable",
            "The result is not available in the requested format.",
            hint=f"Ask for one of {', '.join(dict.fromkeys(MEDIA_TYPES.values()))}.",
        )
    return name


def respond(request: Request, job: Job, storage: Storage, name: str) -> Response:
    """Return the response with the result of `job` in the format `name`, in which it is there.

    Raises
    ------
    Problem
        416 for a range outside the file, 410 where the file has just been removed.
    """
    assert job.results is not None
    size, sha256 = job.results[name]["size"], job.results[name]["sha256"]
    digest = base64.b64encode(bytes.fromhex(sha256)).decode()
    etag = f'"{sha256[:32]}"'
    headers = {
        "ETag": etag,
        "Repr-Digest": f"sha-256=:{digest}:",
        "Vary": "Accept",
        "Cache-Control": "private, no-cache",
    }
    if matches(request.headers.get("if-none-match"), etag):
        return Response(status_code=304, headers=headers)
    span = _one_range(request, size, etag)
    if span is None:
        headers["Content-Digest"] = headers["Repr-Digest"]
    headers["Content-Disposition"] = _attachment(f"{job.upload['name']}_denoised.{name}")
    headers["Last-Modified"] = formatdate((job.finished_at or 0) / 1000, usegmt=True)
    return _file(request, storage, result_file(job, name), headers, MEDIA_TYPES[name], size, span)


def respond_display(request: Request, job: Job, storage: Storage) -> Response:
    """Return the response with what the page draws of `job`, which has succeeded.

    Raises
    ------
    Problem
        404 where the job has no such file, 410 where it has just been removed.
    """
    name = job_file(job.id, DISPLAY)
    try:
        size = storage.size(name)
    except FileNotFoundError:
        raise Problem(
            "display_not_found",
            "This job was run by an older version of the service, which stored no preview.",
            hint="Download the result, or submit the file again.",
        ) from None
    headers = {"ETag": f'"{job.id}"', "Cache-Control": "private, no-cache"}  # a job's file never changes
    if matches(request.headers.get("if-none-match"), headers["ETag"]):
        return Response(status_code=304, headers=headers)
    return _file(request, storage, name, headers, "model/gltf-binary", size)


def _file(
    request: Request,
    storage: Storage,
    name: str,
    headers: dict[str, str],
    media_type: str,
    size: int,
    span: tuple[int, int] | None = None,
) -> Response:
    """Return the response with a file, or with the bytes `span` of it; raise 410 where it has just been removed."""
    start, stop = span or (0, size)
    headers |= {"Accept-Ranges": "bytes", "Content-Length": str(stop - start)}
    if span is not None:
        headers["Content-Range"] = f"bytes {start}-{stop - 1}/{size}"
    status = 200 if span is None else 206
    try:
        if request.method == "HEAD":
            storage.size(name)
            return Response(status_code=status, headers=headers, media_type=media_type)
        return StreamingResponse(storage.read(name, start, stop), status, headers, media_type)
    except FileNotFoundError:
        raise job_expired() from None


def _attachment(name: str) -> str:
    """Return a Content-Disposition by RFC 6266."""
    quoted = quote(name)
    return f'attachment; filename="{name}"' if quoted == name else f"attachment; filename*=utf-8''{quoted}"


def _accepted(accept: str, own: str) -> str | None:
    """Return the format with the highest weight in `accept`; the job's own format where it is free to choose."""
    weights = {own: 0.0} | dict.fromkeys(MEDIA_TYPES, 0.0)
    specificity = dict.fromkeys(weights, -1)
    for item in accept.split(","):
        kind, *options = (part.strip().lower() for part in item.split(";"))
        for name in weights:
            media_type = MEDIA_TYPES.get(name, "")
            rank = {"*/*": 0, f"{media_type.split('/')[0]}/*": 1, media_type: 2}.get(kind, -1)
            if kind == "application/octet-stream" and name == own:
                rank = 2
            if rank > specificity[name]:
                specificity[name], weights[name] = rank, _weight(options)
    best = max(weights, key=lambda name: weights[name])  # the first of equals, the job's own
    return best if weights[best] > 0 else None


def _weight(options: list[str]) -> float:
    for option in options:
        if option.startswith("q="):
            try:
                return min(1.0, max(0.0, float(option[2:])))
            except ValueError:
                return 0.0
    return 1.0


def matches(header: str | None, etag: str) -> bool:
    """Return whether an If-None-Match header names `etag`, by the weak comparison of RFC 9110."""
    if header is None:
        return False
    tags = [tag.strip().removeprefix("W/") for tag in header.split(",")]
    return "*" in tags or etag in tags


def _one_range(request: Request, size: int, etag: str) -> tuple[int, int] | None:
    """Return the one range to send, from its first byte to behind its last, or None for the whole file.

    Several ranges, another unit and a stale If-Range are answered with the whole file, which RFC 9110 allows.
    """
    match = _RANGE.match(request.headers.get("range", "").replace(" ", ""))
    if match is None or not (match[1] or match[2]) or request.headers.get("if-range", etag) != etag:
        return None
    if match[1] and match[2] and int(match[2]) < int(match[1]):
        return None  # not a valid range, so no range
    first = int(match[1]) if match[1] else max(0, size - int(match[2]))
    last = min(int(match[2]), size - 1) if match[1] and match[2] else size - 1
    if first >= size:
        raise Problem(
            "range_not_satisfiable",
            f"The range begins at byte {first}, but the result has only {size} bytes.",
            hint="Ask for a range within the result, or leave Range out.",
            headers={"Content-Range": f"bytes */{size}"},
            limit=size,
            actual=first,
        )
    return first, last + 1
