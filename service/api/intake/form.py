"""The parts of a form (``multipart/form-data``): files, each into a sink of its own, and short parameters."""

from __future__ import annotations

from collections.abc import Callable

from python_multipart.multipart import MultipartParser, parse_options_header

from ...problems import Problem
from .sink import Sink

MAX_FILES = 100
MAX_FIELDS = 16
MAX_FIELD_BYTES = 1024


class Form:
    """What a form holds: at least one part named ``file``, the others short parameters.

    Parameters
    ----------
    new_sink : callable
        Returns where the next file goes.

    Attributes
    ----------
    files : list of Sink
    fields : list of (name, value)
    complete : bool
        Whether the last boundary has come.
    """

    def __init__(self, new_sink: Callable[[], Sink]) -> None:
        self._new_sink = new_sink
        self.files: list[Sink] = []
        self.fields: list[tuple[str, str]] = []
        self.complete = False
        self._header, self._value, self._content = b"", b"", b""
        self._disposition, self._type = b"", b""
        self._name = ""

    def parser(self, boundary: bytes) -> MultipartParser:
        """Return the parser that fills this form."""
        return MultipartParser(
            boundary,
            {
                "on_part_begin": self._begin,
                "on_header_field": self._header_name,
                "on_header_value": self._header_value,
                "on_header_end": self._header_end,
                "on_headers_finished": self._headers_finished,
                "on_part_data": self._data,
                "on_part_end": self._end,
                "on_end": self._finish,
            },
        )

    @property
    def size(self) -> int:
        """Bytes of all files so far."""
        return sum(file.size for file in self.files)

    def check(self) -> None:
        """Refuse a form that is cut off, or has no file.

        Raises
        ------
        Problem
            422 ``invalid_upload``.
        """
        if not self.complete:
            raise malformed()
        if not self.files:
            raise Problem(
                "invalid_upload",
                "The form has no part named `file`.",
                hint="Send a file, for example by curl with -F file=@scan.ply.",
                limit=1,
                actual=0,
            )

    def _begin(self) -> None:
        self._disposition, self._type, self._content, self._name = b"", b"", b"", ""

    def _header_name(self, data: bytes, start: int, end: int) -> None:
        self._header += data[start:end]

    def _header_value(self, data: bytes, start: int, end: int) -> None:
        self._value += data[start:end]

    def _header_end(self) -> None:
        header = self._header.lower()
        if header == b"content-disposition":
            self._disposition = self._value
        elif header == b"content-type":
            self._type = self._value
        self._header, self._value = b"", b""

    def _headers_finished(self) -> None:
        _, options = parse_options_header(self._disposition)
        self._name = options.get(b"name", b"").decode("utf-8", "replace")
        if self._name == "file":
            if len(self.files) == MAX_FILES:
                raise _too_many_files()
            sink = self._new_sink()
            sink.file_name = options.get(b"filename", b"").decode("utf-8", "replace")
            sink.content_type = parse_options_header(self._type)[0].decode("latin-1").lower()
            self.files.append(sink)
        elif b"filename" in options:
            raise _other_name(self._name)
        elif len(self.fields) >= MAX_FIELDS:
            raise Problem(
                "invalid_upload",
                f"The form has more than {MAX_FIELDS} fields.",
                hint="See /docs for the parameters.",
                limit=MAX_FIELDS,
            )

    def _data(self, data: bytes, start: int, end: int) -> None:
        if self._name == "file":
            self.files[-1].add(data[start:end])
            return
        self._content += data[start:end]
        if len(self._content) > MAX_FIELD_BYTES:
            raise Problem(
                "invalid_upload",
                f"A field of the form is longer than {MAX_FIELD_BYTES} bytes.",
                hint="Name the part that holds the cloud `file`. Other parts are parameters.",
                limit=MAX_FIELD_BYTES,
            )

    def _end(self) -> None:
        if self._name != "file":
            self.fields.append((self._name, self._content.decode("utf-8", "replace")))

    def _finish(self) -> None:
        self.complete = True


def malformed() -> Problem:
    """Return the problem for a body that is no form."""
    return Problem(
        "invalid_upload",
        "The multipart body is malformed or incomplete.",
        hint="Let an HTTP library write the form, or curl with -F file=@scan.ply.",
    )


def _other_name(name: str) -> Problem:
    return Problem(
        "invalid_upload",
        f"The form has a file in the part named {name[:40]!r}. A cloud is expected in the part named 'file'.",
        hint="Name the part `file`, for example by curl with -F file=@scan.ply.",
    )


def _too_many_files() -> Problem:
    return Problem(
        "invalid_upload",
        f"The form has more than {MAX_FILES} files.",
        hint=f"Send at most {MAX_FILES} files in one request.",
        limit=MAX_FILES,
        actual=MAX_FILES + 1,
    )
