"""The errors that readers of headers have in common."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NoReturn

from .errors import FormatError


@dataclass(frozen=True)
class HeaderErrors:
    """Raises the errors of one format's header.

    Attributes
    ----------
    subject : str
        What is wrong, after "the": such as ``PLY header``.
    hint : str
        How to get a file without the fault.
    """

    subject: str
    hint: str

    def wrong(self, what: str, *, line: int | None = None, code: str = "bad_header") -> NoReturn:
        """Raise the error for a header that breaks a rule of its format.

        Parameters
        ----------
        what : str
            The rule and how it is broken: a sentence without a capital and a point.
        line : int, optional
            The line of the header, from 1.
        code : str
            A key of :data:`pcdnf.formats.CODES`.
        """
        where = "The" if line is None else f"Line {line} of the"
        raise FormatError(f"{where} {self.subject} is wrong: {what}.", code=code, hint=self.hint)

    def too_long(self, what: str, limit: int) -> NoReturn:
        """Raise the error for a header, or a line of it, of more than `limit` bytes."""
        raise FormatError(
            f"{what} is longer than {limit} bytes.",
            code="header_too_long",
            hint="Remove long or many comments from the header.",
            limit=limit,
        )

    def truncated(self, declared: int, size: int, *, contents: str = "", exact: bool = False) -> NoReturn:
        """Raise the error for a file of `size` bytes that is shorter than its header declares.

        Parameters
        ----------
        declared : int
            Bytes of the file that the header describes, or the fewest it can have.
        size : int
            Bytes that are there.
        contents : str
            What the header declares besides, such as ``12 vertices``.
        exact : bool
            Whether `declared` is not only a lower bound.
        """
        bytes_ = f"{'' if exact else 'at least '}{declared} bytes"
        raise FormatError(
            f"The {self.subject} declares {f'{contents} and ' if contents else ''}a file of {bytes_}; "
            f"the file has {size}.",
            code="truncated",
            hint="The file is cut off, or its header declares too much: copy or export it again.",
            limit=declared,
            actual=size,
        )

    def trailing(self, declared: int, size: int, *, hint: str) -> NoReturn:
        """Raise the error for a file of `size` bytes that is longer than its header declares."""
        raise FormatError(
            f"The {self.subject} declares a file of {declared} bytes; the file has {size}.",
            code="trailing_data",
            hint=hint,
            limit=declared,
            actual=size,
        )
