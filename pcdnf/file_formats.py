"""The formats there are: names, media types, file suffixes, first bytes, and the library that one of them needs.

Nothing here reads a file; that is what ``pcdnf.formats`` does.
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass


@dataclass(frozen=True)
class Format:
    """A format of files.

    Attributes
    ----------
    title : str
        Its name in sentences.
    media_type : str
        The Content-Type of a result.
    suffixes : tuple of str
        Of file names, in lower case.
    magic : tuple of bytes
        First bytes that announce it; none for text, which only its name tells.
    library, extra : str
        A package that must be there, and the extra that brings it; empty when none is needed.
    """

    title: str
    media_type: str
    suffixes: tuple[str, ...]
    magic: tuple[bytes, ...] = ()
    library: str = ""
    extra: str = ""

    @property
    def available(self) -> bool:
        """Whether its library is installed."""
        return not self.library or importlib.util.find_spec(self.library) is not None


FORMATS = {
    "ply": Format("PLY", "application/ply", (".ply",), (b"ply\n", b"ply\r")),
    "npz": Format("NPZ", "application/x-npz", (".npz",), (b"PK\x03\x04", b"\x93NUMPY")),
    "pcd": Format("PCD", "application/x-pcd", (".pcd",), (b"# .PCD", b"VERSION ")),
    "xyz": Format("XYZ", "text/plain", (".xyz", ".txt", ".asc", ".xyzn", ".xyzrgb")),
    "csv": Format("CSV", "text/csv", (".csv",)),
    "pts": Format("PTS", "text/plain", (".pts",)),
    "ptx": Format("PTX", "text/plain", (".ptx",)),
    "las": Format("LAS", "application/vnd.las", (".las",), (b"LASF",)),
    "laz": Format("LAZ", "application/vnd.laszip", (".laz",), (b"LASF",), "lazrs", "las"),
    "e57": Format("E57", "model/e57", (".e57",), (b"ASTM-E57",), "pye57", "e57"),
}
"""Every format by its name, which is also the ending of a result's file."""

TEXT_FORMATS = tuple(name for name, format_ in FORMATS.items() if not format_.magic)
"""Formats without first bytes of their own: columns of text."""

SUFFIXES = {suffix: name for name, format_ in FORMATS.items() for suffix in format_.suffixes}
"""File name endings, and the format they ask for."""


def available() -> list[str]:
    """Names of the formats that can be read and written here."""
    return [name for name, format_ in FORMATS.items() if format_.available]


def titles() -> str:
    """List the formats that can be read here, as part of a sentence."""
    known = [FORMATS[name].title for name in available()]
    return f"{', '.join(known[:-1])} or {known[-1]}"
