"""The format of a file by its first bytes, and the names of files that are not read."""

from __future__ import annotations

from typing import BinaryIO

from ..file_formats import titles
from .errors import FormatError, check_available
from .registry import CODECS

OTHERS = {
    b"glTF": "a binary glTF (GLB)",
    b"{": "JSON, such as a glTF",
    b"solid ": "an STL mesh without triangles",
    b"OFF": "a binary OFF mesh",
    b"Kaydara FBX": "an FBX scene",
    b"\x1f\x8b": "packed by gzip twice",
    b"NGSP": "a file of SPZ splats",
    b"\x89HDF": "an HDF5 file",
    b"AC10": "a DWG drawing",
    b"ncp": "a Leica or Bentley point cloud",
}
"""First bytes of files that people have and that are not read."""
OTHER_SUFFIXES = {
    ".splat": "Gaussian splats without a signature",
    ".ksplat": "Gaussian splats of a web viewer",
    ".dxf": "a DXF drawing",
    ".fls": "a FARO scan",
    ".rcs": "an Autodesk ReCap scan",
    ".rcp": "an Autodesk ReCap project",
    ".zfs": "a Zoller + Froehlich scan",
    ".rxp": "a RIEGL scan",
    ".bin": "a binary file without a signature, such as one of CloudCompare or KITTI",
}
"""Endings of names for files that have no first bytes of their own, and are not read."""

MAGIC_BYTES = 16
"""Enough for every signature."""
_PTX_HEAD_BYTES = 2048


def sniff(head: bytes, *, text: bool = False, suffix: str = "") -> str:
    """Return the format of a file by its first bytes (16 are enough); "xyz" for unknown bytes if `text` is true.

    Parameters
    ----------
    head : bytes
    text : bool
        Whether other first bytes are those of columns of text.
    suffix : str
        The ending of the file's name, by which a refusal says what it is.

    Raises
    ------
    FormatError
        ``empty_file``, ``unknown_format``, or ``missing_extra`` for a format whose library is not there.
    """
    for name, codec in CODECS.items():
        if codec.sniff(head):
            check_available(name)
            return name
    if not head:
        raise FormatError("The file is empty.", code="empty_file", hint=f"Send {titles()}.")
    if text:
        return "xyz"
    title = next((title for magic, title in OTHERS.items() if head.startswith(magic)), OTHER_SUFFIXES.get(suffix))
    if title is not None:
        raise FormatError(
            f"The file is {title}, which cannot be read.",
            code="unknown_format",
            hint="Export its points as PLY or LAZ.",
        )
    raise FormatError(
        f"The format of the file is unknown: its first bytes match none of {titles()}.",
        code="unknown_format",
        hint="Send a PLY file, or arrays saved with numpy.savez(path, points=…); name text files .xyz or .csv.",
    )


def is_ptx(file: BinaryIO) -> bool:
    """Return whether text begins as a PTX does: two whole numbers, then three lines and more of three numbers."""
    head = file.read(_PTX_HEAD_BYTES).split(b"\n")
    file.seek(0)
    widths = [len(line.split()) for line in head if line.strip()][:10]
    return widths == [1, 1, 3, 3, 3, 3, 4, 4, 4, 4]
