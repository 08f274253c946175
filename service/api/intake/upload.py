"""The body of an upload: streamed to files and counted as it arrives, with a deadline and a minimum speed."""

from __future__ import annotations

import re
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field
from pathlib import Path

from fastapi import Request
from python_multipart.exceptions import FormParserError
from python_multipart.multipart import parse_options_header
from starlette.requests import ClientDisconnect

from pcdnf.file_formats import FORMATS, PACKED_SUFFIXES, SUFFIXES, TEXT_FORMATS, UNWRITTEN_SUFFIXES, available, titles

from ...problems import Problem
from ...settings import Settings
from .content_coding import decoded
from .form import Form, malformed
from .sink import Sink, Tally, too_large
from .upload_pace import chunks

OTHER_TYPES = ("application/octet-stream",)  # in addition to those of the formats
RAW_TYPES = tuple(dict.fromkeys([*(FORMATS[name].media_type for name in available()), *OTHER_TYPES]))
CURL_TYPE = "application/x-www-form-urlencoded"  # what curl --data-binary calls every body
TEXT_TYPES = tuple(FORMATS[name].media_type for name in TEXT_FORMATS)
FORM_TYPE = "multipart/form-data"
MULTIPART_OVERHEAD = 64 * 1024  # what headers, boundaries and fields may add to the files
MAX_NAME = 100
FALLBACK_NAME = "cloud"
FILE_NAME = "filename"
"""The query parameter with the name of a file that is the whole body."""


@dataclass(frozen=True)
class Upload:
    """A file that arrived."""

    path: Path
    name: str  # the cleaned stem of the caller's file name; never used as a path
    size: int
    sha256: str  # of the file, in hex
    is_text: bool  # by its type or name it may be plain-text columns, which have no signature


@dataclass
class Received:
    """What a request held."""

    files: list[Upload]
    fields: list[tuple[str, str]] = field(default_factory=list)


def clean_name(name: str | None) -> str:
    """Return the stem of a caller's file name, reduced to what is safe in a header and on any disk."""
    stem = _unpacked(re.split(r"[/\\]", name or "")[-1])
    stem = stem[: -len(_suffix(stem))] if _suffix(stem) in (*SUFFIXES, *UNWRITTEN_SUFFIXES) else stem
    stem = re.sub(r"[^\w .()+-]", "_", stem).strip(" ._")
    return stem[:MAX_NAME].rstrip(" .") or FALLBACK_NAME


def _unpacked(name: str) -> str:
    """Return a file name without the extension of its packing."""
    return name[: -len(_suffix(name))] if _suffix(name) in PACKED_SUFFIXES else name


def _suffix(name: str) -> str:
    """Return the ending of a file name in lower case with its dot, or an empty string."""
    return "." + name.rpartition(".")[2].lower() if "." in name else ""


async def receive(request: Request, scratch: Callable[[], Path], settings: Settings) -> Received:
    """Stream the body of `request` to files.

    Parameters
    ----------
    request : Request
    scratch : callable
        Returns the path of a new file.
    settings : Settings

    Raises
    ------
    Problem
        408, 413, 415 or 422. All files are removed then, and also if the caller disconnects or the disk is full.
    """
    kind, options = parse_options_header(request.headers.get("content-type", ""))
    content_type = kind.decode("latin-1").lower()
    _check_headers(request, content_type, settings)
    tally = Tally(settings.upload_limit)
    sinks: list[Sink] = []

    def new_sink() -> Sink:
        sinks.append(Sink(scratch(), tally))
        return sinks[-1]

    try:
        body = decoded(request, chunks(request, settings))
        if content_type == FORM_TYPE:
            fields = await _multipart(body, options.get(b"boundary", b""), new_sink)
        else:
            fields = []
            await _raw(request, body, content_type, new_sink())
        for sink in sinks:
            await sink.flush(everything=True)
            if sink.size == 0:
                raise Problem("empty_upload", "The upload has 0 bytes.", hint=f"Send {titles()}.")
        return Received([_upload(sink) for sink in sinks], fields)
    except BaseException as error:
        for sink in sinks:
            sink.path.unlink(missing_ok=True)
        if isinstance(error, ClientDisconnect):
            raise Problem(
                "bad_request", "The connection closed before the upload was complete.", hint="Send the file again."
            ) from error
        raise
    finally:
        for sink in sinks:
            sink.close()


def declared_bytes(request: Request) -> int:
    """Return the Content-Length of a request, or 0 if it is unknown."""
    declared = request.headers.get("content-length", "")
    return int(declared) if declared.isascii() and declared.isdigit() else 0


def _upload(sink: Sink) -> Upload:
    ending = SUFFIXES.get(_suffix(_unpacked(sink.file_name)))
    is_text = sink.content_type in TEXT_TYPES or ending in TEXT_FORMATS
    return Upload(sink.path, clean_name(sink.file_name), sink.size, sink.sha256, is_text)


def _check_headers(request: Request, content_type: str, settings: Settings) -> None:
    if content_type not in (FORM_TYPE, CURL_TYPE, *RAW_TYPES):
        raise Problem(
            "unsupported_media_type",
            "The Content-Type of the upload is missing or not supported.",
            hint=f"Send multipart/form-data with a part named `file`, or the file itself as {' or '.join(RAW_TYPES)}.",
            headers={"Accept-Post": ", ".join((FORM_TYPE, *RAW_TYPES))},
        )
    overhead = MULTIPART_OVERHEAD if content_type == FORM_TYPE else 0
    if declared_bytes(request) > settings.upload_limit + overhead:
        raise too_large(settings.upload_limit, declared_bytes(request))


async def _raw(request: Request, body: AsyncIterator[bytes], content_type: str, sink: Sink) -> None:
    sink.content_type, sink.file_name = content_type, _given_name(request)
    async for chunk in body:
        sink.add(chunk)
        await sink.flush()


def _given_name(request: Request) -> str:
    """Return the name of a file that is the whole body, from the query or from ``Content-Disposition``."""
    if FILE_NAME in request.query_params:
        return request.query_params[FILE_NAME]
    _, options = parse_options_header(request.headers.get("content-disposition", ""))
    return options.get(b"filename", b"").decode("utf-8", "replace")


async def _multipart(
    body: AsyncIterator[bytes], boundary: bytes, new_sink: Callable[[], Sink]
) -> list[tuple[str, str]]:
    form = Form(new_sink)
    received = 0
    try:
        parser = form.parser(boundary)
        async for chunk in body:
            received += len(chunk)
            if received - form.size > MULTIPART_OVERHEAD + len(chunk):
                raise Problem(
                    "invalid_upload",
                    f"The form has more than {MULTIPART_OVERHEAD} bytes beside its files.",
                    hint="Send parts named `file` and the parameters, nothing else.",
                    limit=MULTIPART_OVERHEAD,
                )
            parser.write(chunk)
            for sink in form.files[-2:]:  # a chunk may end one file and begin the next ones
                await sink.flush()
        parser.finalize()
    except (FormParserError, ValueError) as error:
        raise malformed() from error
    form.check()
    return form.fields
