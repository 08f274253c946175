"""The error for point-cloud files, with a table of its codes."""

from __future__ import annotations

from ..errors import PcdnfError
from ..file_formats import FORMATS

CODES = {
    "bad_header": "the header breaks a rule of its format",
    "bad_member_name": "an NPZ member has a name that is not `<name>.npy`",
    "bad_value": "a text value is not a number, or does not fit its declared type",
    "bad_shape": "an array does not have the shape its role asks for",
    "cannot_store": "the cloud carries values that the asked format cannot hold",
    "compression_ratio": "compressed data inflates far more than measurements do",
    "corrupt_archive": "compressed data contradicts itself: offsets, sizes, checksum",
    "disk_full": "there is no room for the file that is written",
    "duplicate_member": "an NPZ has two members of one name",
    "duplicate_property": "two columns have one name",
    "empty_file": "the file has no bytes",
    "encrypted_archive": "an NPZ member is encrypted",
    "extent_out_of_range": "the bounding-box diagonal is outside [1e-12, 1e12]",
    "file_too_large": "the file, or what it inflates to, is over the byte limit",
    "geographic_coordinates": "x and y are degrees, heights are metres",
    "header_too_long": "a header, or a line or a list in it, is over its limit",
    "member_too_large": "an NPZ member that carries text is over its limit",
    "missing_column": "a column that was asked for is not in the file",
    "missing_coordinates": "no x, y, z, or no points member",
    "missing_extra": "the library that reads the format is not installed",
    "nonfinite": "coordinates or normals contain NaN or infinity",
    "not_enough_memory": "reading needs more memory than the reader may take",
    "too_few_points": "fewer points than the method needs",
    "too_many_elements": "too many properties, fields or columns",
    "too_many_members": "too many NPZ members",
    "too_many_points": "more points than the limit",
    "took_too_long": "reading takes more processor time than the reader may take",
    "trailing_data": "bytes remain after the last element",
    "truncated": "the file ends before what its header declares",
    "unknown_format": "the first bytes are of no known format",
    "unreadable_file": "the path does not lead to a regular file that can be opened",
    "unsupported_compression": "data is packed in a way that is not known, or newer than the library",
    "unsupported_dtype": "an array is not of real floating-point numbers or integers",
    "unsupported_type": "a column has a type the format does not define",
    "unsupported_zip64": "an NPZ uses the zip extension for 4 GiB and more",
    "unwritten_format": "files with this extension are only read",
    "written_wrong": "a result that was read back after writing is not what was written",
    "zero_extent": "all points are equal",
}
"""Every ``code`` that a :class:`FormatError` may carry, and what it stands for."""


class FormatError(PcdnfError):
    """A file that cannot be read, or a cloud that cannot be written, as a point cloud.

    Parameters
    ----------
    message : str
        Sentences of our own, never a library's.
    code : str
        A key of :data:`CODES`.
    hint : str
        What to do about it.
    limit, actual : int, optional
        The bound that was broken and the value that broke it, where numbers apply.
    """

    def __init__(
        self, message: str, *, code: str, hint: str, limit: int | None = None, actual: int | None = None
    ) -> None:
        if code not in CODES:
            raise ValueError(f"{code!r} is not listed in pcdnf.formats.errors.CODES")
        super().__init__(message, code=code, hint=hint)
        self.limit = limit
        self.actual = actual


def shown(name: str, width: int = 48) -> str:
    """Return a name from a foreign file, quoted, in ASCII and short enough for a sentence."""
    text = ascii(name)
    return text if len(text) <= width else f"{text[:width]}…'"


def check_available(name: str) -> None:
    """Raise ``missing_extra`` unless the library of a format is installed."""
    format_ = FORMATS[name]
    if not format_.available:
        raise FormatError(
            f"{format_.title} needs the library {format_.library}, which is not installed here.",
            code="missing_extra",
            hint=f"Install it with: pip install 'pcdnf[{format_.extra}]'; or convert the file to PLY.",
        )
