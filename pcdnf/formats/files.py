"""Reading and writing by path: what a file is by its first bytes, and replacing one in a single step."""

from __future__ import annotations

import os
import secrets
import stat
from contextlib import suppress
from pathlib import Path
from typing import Literal

from .cloud import Limits, PointCloud
from .errors import FormatError
from .npz import read_npz, write_npz
from .ply import read_ply, write_ply

MAGIC: dict[bytes, Literal["ply", "npz"]] = {b"ply\n": "ply", b"ply\r\n": "ply", b"PK\x03\x04": "npz"}
"""First bytes, and the format they announce."""

READERS = {"ply": read_ply, "npz": read_npz}
WRITERS = {"ply": write_ply, "npz": write_npz}


def sniff(head: bytes) -> Literal["ply", "npz"]:
    """The format of a file by its first bytes (8 are enough), never by its name.

    Raises
    ------
    FormatError
        ``empty_file`` or ``unknown_format``.
    """
    for magic, name in MAGIC.items():
        if head.startswith(magic):
            return name
    if not head:
        raise FormatError("The file is empty.", code="empty_file", hint="Send a PLY or an NPZ file.")
    raise FormatError(
        "The file is neither PLY nor NPZ: its first bytes are neither a line `ply` nor PK 03 04.",
        code="unknown_format",
        hint="Send a PLY file, or arrays saved with numpy.savez(path, points=…).",
    )


def read(path: str | os.PathLike[str], *, limits: Limits | None = None) -> PointCloud:
    """Read a point cloud, checking every size before memory is taken for it.

    Parameters
    ----------
    path : path-like
        A PLY or an NPZ, whatever its name.
    limits : Limits, optional
        What is accepted; by default anything a machine can hold.

    Returns
    -------
    PointCloud

    Raises
    ------
    FormatError
        With the code of what is wrong; see :data:`pcdnf.formats.errors.CODES`.
    """
    limits = limits or Limits()
    _check_regular(path)
    with Path(path).open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        if size > limits.max_bytes:
            raise FormatError(
                f"The file has {size} bytes; the limit is {limits.max_bytes}.",
                code="file_too_large",
                hint="Cut the cloud into parts, or thin it out.",
                limit=limits.max_bytes,
                actual=size,
            )
        kind = sniff(file.read(8))
        file.seek(0)
        return READERS[kind](file, size, limits)


def _check_regular(path: str | os.PathLike[str]) -> None:
    """Raise ``unreadable_file`` unless the path leads to a regular file that may be read."""
    try:
        mode = Path(path).stat().st_mode
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or "its name is not a path"
        raise _unreadable(why) from None
    if not stat.S_ISREG(mode):
        raise _unreadable("it is not a regular file")
    if not os.access(path, os.R_OK):
        raise _unreadable("permission denied")


def _unreadable(why: str) -> FormatError:
    return FormatError(
        f"The file cannot be read: {why[:1].lower()}{why[1:]}.",
        code="unreadable_file",
        hint="Check the path and its permissions.",
    )


def write(path: str | os.PathLike[str], cloud: PointCloud, *, format: Literal["ply", "npz"] | None = None) -> list[str]:
    """Write a cloud in one step: a reader sees the old file or the whole new one, also after a power loss.

    Parameters
    ----------
    path : path-like
        Replaced if it exists.
    cloud : PointCloud
    format : {"ply", "npz"}, optional
        By default as the cloud came, with the same encoding, types, names and order.

    Returns
    -------
    list of str
        Sentences on what the format could not carry.

    Raises
    ------
    FormatError
        ``cannot_store``.
    OSError
        When the disk refuses.
    """
    target = Path(path)
    temporary = target.with_name(f".pcdnf-{secrets.token_hex(8)}.tmp")
    try:
        with temporary.open("xb") as file:
            notes = WRITERS[format or cloud.flavour.format](file, cloud)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(target)
    except BaseException:
        with suppress(FileNotFoundError):
            temporary.unlink()
        raise
    _sync_folder(target.parent)
    return notes


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
