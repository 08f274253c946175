"""Table of the file formats: name, media type, extensions, first bytes, and the library that a format needs.

``pcdnf.formats`` reads and writes the files; this table imports nothing.
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass


@dataclass(frozen=True)
class Format:
    """A file format.

    Attributes
    ----------
    title : str
        Name in sentences.
    media_type : str
        The Content-Type of a result.
    suffixes : tuple of str
        Extensions of file names, in lower case.
    magic : tuple of bytes
        First bytes of a file; none for text, which is recognised by its extension.
    library, extra : str
        Required package, and the extra that installs it; empty if none is needed.
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
"""Every format by its name, which is also the extension of a result's file."""

TEXT_FORMATS = tuple(name for name, format_ in FORMATS.items() if not format_.magic)
"""Formats without a signature: columns of text."""

SUFFIXES = {suffix: name for name, format_ in FORMATS.items() for suffix in format_.suffixes}
"""File extensions and their formats."""

ANY_COLUMNS = (".xyz", ".txt", ".asc")
"""Extensions of text whose columns may stand in any layout, with commas or a count as well as with blanks."""

READ_SUFFIXES = (*SUFFIXES, ".obj", ".off", ".stl", ".npy")
"""Extensions of files that hold a cloud."""

PACKED_SUFFIXES = (".gz", ".zip")
"""Extensions of packed files; they are read if they hold one cloud."""

UNWRITTEN_SUFFIXES = (".obj", ".off", ".stl", ".glb", ".gltf", ".splat", ".spz", ".gz", ".zip")
"""Extensions of meshes, splats and packed files, as which no result is written; a PLY holds the faces of a mesh."""


def available() -> list[str]:
    """List the names of the formats that can be read and written here."""
    return [name for name, format_ in FORMATS.items() if format_.available]


def titles() -> str:
    """List the formats that can be read here, as part of a sentence."""
    known = [FORMATS[name].title for name in available()]
    return f"{', '.join(known[:-1])} or {known[-1]}"
