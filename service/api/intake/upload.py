"""The body of an upload: streamed to a file and counted as it arrives, with a deadline and a minimum speed."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from fastapi import Request
from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, parse_options_header
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect

from pcdnf.file_formats import FORMATS, SUFFIXES, TEXT_FORMATS, UNWRITTEN_SUFFIXES, available, titles

from ...problems import Problem
from ...settings import MIB, Settings
from .upload_pace import chunks

OTHER_TYPES = ("application/octet-stream",)  # in addition to those of the formats
RAW_TYPES = tuple(dict.fromkeys([*(FORMATS[name].media_type for name in available()), *OTHER_TYPES]))
TEXT_TYPES = tuple(FORMATS[name].media_type for name in TEXT_FORMATS)
WRITE_BYTES = MIB  # written to disk at a time, off the event loop
MULTIPART_OVERHEAD = 64 * 1024  # what headers, boundaries and fields may add to the file
MAX_FIELDS = 16
MAX_FIELD_BYTES = 1024
MAX_NAME = 100
FALLBACK_NAME = "cloud"


@dataclass
class Upload:
    """What arrived."""

    name: str  # the cleaned stem of the caller's file name; never used as a path
    size: int
    sha256: str  # of the file, in hex
    fields: list[tuple[str, str]]
    is_text: bool = False  # by its type or name it may be plain-text columns, which have no signature


def clean_name(name: str | None) -> str:
    """Return the stem of a caller's file name, reduced to what is safe in a header and on any disk."""
    stem = re.split(r"[/\\]", name or "")[-1]
    stem = stem[: -len(_suffix(stem))] if _suffix(stem) in (*SUFFIXES, *UNWRITTEN_SUFFIXES) else stem
    stem = re.sub(r"[^\w .()+-]", "_", stem).strip(" ._")
    return stem[:MAX_NAME].rstrip(" .") or FALLBACK_NAME


def _suffix(name: str) -> str:
    """Return the ending of a file name in lower case with its dot, or an empty string."""
    return "." + name.rpartition(".")[2].lower() if "." in name else ""


async def receive(request: Request, path: Path, settings: Settings) -> Upload:
    """Stream the body of `request` to `path`.

    Raises
    ------
    Problem
        408, 413, 415 or 422. `path` is removed then, and also if the caller disconnects or the disk is full.
    """
    kind, options = parse_options_header(request.headers.get("content-type", ""))
    content_type = kind.decode("latin-1").lower()
    _check_headers(request, content_type, settings)
    try:
        with path.open("wb") as file:
            if content_type == "multipart/form-data":
                upload = await _multipart(request, options.get(b"boundary", b""), _Sink(file.fileno(), settings))
            else:
                upload = await _raw(request, _Sink(file.fileno(), settings))
    except BaseException as error:
        path.unlink(missing_ok=True)
        if isinstance(error, ClientDisconnect):
            raise Problem(
                "bad_request", "The connection closed before the upload was complete.", hint="Send the file again."
            ) from error
        raise
    if upload.size == 0:
        path.unlink(missing_ok=True)
        raise Problem("empty_upload", "The upload has 0 bytes.", hint=f"Send {titles()}.")
    upload.is_text |= content_type in TEXT_TYPES
    return upload


def declared_bytes(request: Request) -> int:
    """Return the Content-Length of a request, or 0 if it is unknown."""
    declared = request.headers.get("content-length", "")
    return int(declared) if declared.isascii() and declared.isdigit() else 0


def _check_headers(request: Request, content_type: str, settings: Settings) -> None:
    if request.headers.get("content-encoding", "identity").lower() != "identity":
        raise Problem("unsupported_encoding", "The upload has a Content-Encoding.", hint="Send the file without one.")
    if content_type != "multipart/form-data" and content_type not in RAW_TYPES:
        raise Problem(
            "unsupported_media_type",
            "The Content-Type of the upload is missing or not supported.",
            hint=f"Send multipart/form-data with a part named `file`, or the file itself as {' or '.join(RAW_TYPES)}.",
            headers={"Accept-Post": ", ".join(("multipart/form-data", *RAW_TYPES))},
        )
    overhead = MULTIPART_OVERHEAD if content_type == "multipart/form-data" else 0
    if declared_bytes(request) > settings.max_upload_bytes + overhead:
        raise _too_large(settings, declared_bytes(request))


class _Sink:
    """Counts the file's bytes and writes them in large pieces, off the event loop."""

    def __init__(self, descriptor: int, settings: Settings) -> None:
        self._descriptor = descriptor
        self._settings = settings
        self._buffer = bytearray()
        self._hash = hashlib.sha256()
        self.size = 0

    @property
    def settings(self) -> Settings:
        return self._settings

    def add(self, data: bytes) -> None:
        self.size += len(data)
        if self.size > self._settings.max_upload_bytes:
            raise _too_large(self._settings, self.size)
        self._buffer += data

    async def flush(self, *, everything: bool = False) -> None:
        if self._buffer and (everything or len(self._buffer) >= WRITE_BYTES):
            data, self._buffer = self._buffer, bytearray()
            await run_in_threadpool(self._write, data)

    def _write(self, data: bytearray) -> None:
        self._hash.update(data)
        view = memoryview(data)
        while view:
            view = view[os.write(self._descriptor, view) :]

    def finished(self, name: str, fields: Iterable[tuple[str, str]] = ()) -> Upload:
        """Return what was written."""
        return Upload(name, self.size, self._hash.hexdigest(), list(fields))


async def _raw(request: Request, sink: _Sink) -> Upload:
    async for chunk in chunks(request, sink.settings):
        sink.add(chunk)
        await sink.flush()
    await sink.flush(everything=True)
    return sink.finished(FALLBACK_NAME)


async def _multipart(request: Request, boundary: bytes, sink: _Sink) -> Upload:
    form = _Form(sink)
    received = 0
    try:
        parser = MultipartParser(
            boundary,
            {
                "on_part_begin": form.begin,
                "on_header_field": form.header_name,
                "on_header_value": form.header_value,
                "on_header_end": form.header_end,
                "on_headers_finished": form.headers_finished,
                "on_part_data": form.data,
                "on_part_end": form.end,
                "on_end": form.finish,
            },
        )
        async for chunk in chunks(request, sink.settings):
            received += len(chunk)
            if received - sink.size > MULTIPART_OVERHEAD + len(chunk):
                raise Problem(
                    "invalid_upload",
                    f"The form has more than {MULTIPART_OVERHEAD} bytes beside the file.",
                    hint="Send one part named `file` and the parameters, nothing else.",
                    limit=MULTIPART_OVERHEAD,
                )
            parser.write(chunk)
            await sink.flush()
        parser.finalize()
    except (FormParserError, ValueError) as error:
        raise _malformed() from error
    await sink.flush(everything=True)
    if not form.complete:
        raise _malformed()
    if form.files != 1:
        raise _not_one_file(form.files)
    upload = sink.finished(clean_name(form.file_name), form.fields)
    ending = SUFFIXES.get(_suffix(form.file_name or ""))
    upload.is_text = form.content_type in TEXT_TYPES or ending in TEXT_FORMATS
    return upload


class _Form:
    """The parts of a form: exactly one named ``file``, the others short parameters."""

    def __init__(self, sink: _Sink) -> None:
        self._sink = sink
        self.fields: list[tuple[str, str]] = []
        self.files = 0
        self.file_name: str | None = None
        self.content_type = ""
        self.complete = False
        self._header, self._value, self._content = b"", b"", b""
        self._disposition, self._type = b"", b""
        self._name = ""

    def begin(self) -> None:
        self._disposition, self._type, self._content, self._name = b"", b"", b"", ""

    def header_name(self, data: bytes, start: int, end: int) -> None:
        self._header += data[start:end]

    def header_value(self, data: bytes, start: int, end: int) -> None:
        self._value += data[start:end]

    def header_end(self) -> None:
        if self._header.lower() == b"content-disposition":
            self._disposition = self._value
        if self._header.lower() == b"content-type":
            self._type = self._value
        self._header, self._value = b"", b""

    def headers_finished(self) -> None:
        _, options = parse_options_header(self._disposition)
        self._name = options.get(b"name", b"").decode("utf-8", "replace")
        if self._name == "file":
            self.files += 1
            if self.files > 1:
                raise _not_one_file(self.files)
            self.file_name = options.get(b"filename", b"").decode("utf-8", "replace")
            self.content_type = parse_options_header(self._type)[0].decode("latin-1").lower()
        elif len(self.fields) >= MAX_FIELDS:
            raise Problem(
                "invalid_upload",
                f"The form has more than {MAX_FIELDS} fields.",
                hint="See /docs for the parameters.",
                limit=MAX_FIELDS,
            )

    def data(self, data: bytes, start: int, end: int) -> None:
        if self._name == "file":
            self._sink.add(data[start:end])
            return
        self._content += data[start:end]
        if len(self._content) > MAX_FIELD_BYTES:
            raise Problem(
                "invalid_upload",
                f"A field of the form is longer than {MAX_FIELD_BYTES} bytes.",
                hint="Name the part that holds the cloud `file`. Other parts are parameters.",
                limit=MAX_FIELD_BYTES,
            )

    def end(self) -> None:
        if self._name != "file":
            self.fields.append((self._name, self._content.decode("utf-8", "replace")))

    def finish(self) -> None:
        self.complete = True


def _too_large(settings: Settings, actual: int) -> Problem:
    return Problem(
        "upload_too_large",
        f"The upload is larger than {settings.max_upload_bytes} bytes, the limit of this service.",
        hint="Send a smaller cloud, or a binary file instead of text.",
        limit=settings.max_upload_bytes,
        actual=actual,
    )


def _malformed() -> Problem:
    return Problem(
        "invalid_upload",
        "The multipart body is malformed or incomplete.",
        hint="Let an HTTP library write the form, or curl with -F file=@scan.ply.",
    )


def _not_one_file(actual: int) -> Problem:
    return Problem(
        "invalid_upload",
        "The form must have exactly one part named `file`.",
        hint="Send one file, for example by curl with -F file=@scan.ply.",
        limit=1,
        actual=actual,
    )
