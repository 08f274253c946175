"""Reading and writing by path, and replacing a file in a single step."""

from __future__ import annotations

import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..file_formats import ANY_COLUMNS, FORMATS, SUFFIXES, TEXT_FORMATS, UNWRITTEN_SUFFIXES
from .attributes import renamed
from .codec import Codec
from .coordinates import Coordinates, with_coordinates, without_steps
from .errors import FormatError, check_available, shown
from .flavours import PcdFlavour, PlyFlavour
from .limits import Limits
from .mesh.codec import HEAD_BYTES, mesh_kind, read_mesh
from .packed import is_packed, unpacked
from .point_cloud import PointCloud
from .readback import check_written
from .registry import CODECS, COPC, COPC_ENDING
from .signatures import MAGIC_BYTES, is_ptx, sniff

_OWN_TYPES = ("las", "laz", "e57", "csv", "pts", "ptx")  # or without a place for an offset
_LAYOUTS = ("xyz", "csv", "pts")  # of columns of text; a PTX is no table


def read(path: str | os.PathLike[str], *, limits: Limits | None = None, text: bool | None = None) -> PointCloud:
    """Read a point cloud, checking every size before memory is taken for it.

    Parameters
    ----------
    path : path-like
        A file of a format of :data:`pcdnf.file_formats.FORMATS`, whatever its name; also packed by gzip, or alone in
        a zip archive.
    limits : Limits, optional
        What is accepted; by default anything a machine can hold.
    text : bool, optional
        Whether a file whose first bytes say nothing is columns of text; by default its name tells.

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
        if not is_packed(file):
            return _read_open(file, path, limits, text)
        with unpacked(file, Path(path).name, limits.max_bytes) as plain, plain.open("rb") as inside:
            return _read_open(inside, plain, limits, text or None)


def _read_open(file: BinaryIO, path: str | os.PathLike[str], limits: Limits, text: bool | None) -> PointCloud:
    """Read an open file that is not packed; its name counts where its first bytes say nothing."""
    size = os.fstat(file.fileno()).st_size
    head = file.read(HEAD_BYTES)
    file.seek(0)
    mesh = mesh_kind(head, size)
    if mesh is not None:
        return without_steps(read_mesh(file, mesh, limits))
    suffix = Path(path).suffix.lower()
    kind = sniff(head[:MAGIC_BYTES], text=is_text(path) if text is None else text, suffix=suffix)
    if kind == "xyz" and (suffix == ".ptx" or (text and is_ptx(file))):
        kind = "ptx"
    return without_steps(CODECS[kind].read(file, size, limits))


def is_text(path: str | os.PathLike[str]) -> bool:
    """Return whether a file is columns of text by its name."""
    return SUFFIXES.get(Path(path).suffix.lower()) in TEXT_FORMATS


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


def write(
    path: str | os.PathLike[str],
    cloud: PointCloud,
    *,
    format: str | None = None,
    coordinates: Coordinates = "keep",
    check: bool = False,
) -> list[str]:
    """Write a cloud in one step: a reader sees the old file or the whole new one, also after a power loss.

    Parameters
    ----------
    path : path-like
        Replaced if it exists.
    cloud : PointCloud
    format : str, optional
        A name of :data:`pcdnf.file_formats.FORMATS`.
        By default the one of the path's extension, or of the cloud if the extension is none or unknown. If it is the
        format in which the cloud came, encoding, types, names and order stay.
    coordinates : {"keep", "float32", "float64"}
        The type of the coordinates; float32 far from the origin are moved by an offset, which is recorded. LAS, LAZ,
        E57 and text without comments keep types of their own.
    check : bool
        Whether the file is read back, and compared with the cloud, before it takes the place of ``path``.

    Returns
    -------
    list of str
        Sentences on what the format could not carry.

    Raises
    ------
    FormatError
        ``cannot_store``, ``missing_extra``, ``unwritten_format`` or ``written_wrong``.
    OSError
        When the disk refuses.
    """
    name = format or format_to_write(path, cloud.flavour.format)
    check_available(name)
    codec = COPC if name == "laz" and os.fspath(path).lower().endswith(COPC_ENDING) else CODECS[name]
    typed, moved = _typed(cloud, codec, coordinates)
    if codec.name == "pcd" and coordinates == "float64" and not isinstance(typed.flavour, PcdFlavour):
        typed = replace(typed, flavour=PcdFlavour(), attributes=renamed(typed.attributes))
    stored, notes = _storable(typed, codec)
    notes = moved + notes
    with replacing(path) as file:
        notes += codec.write(file, stored)
        if check:
            file.flush()
            check_written(file, os.fstat(file.fileno()).st_size, stored, codec)
    return notes


def _typed(cloud: PointCloud, codec: Codec, coordinates: Coordinates) -> tuple[PointCloud, list[str]]:
    """Return the cloud with coordinates of the wanted type if the format has it, and sentences on that."""
    if codec.name not in _OWN_TYPES:
        return with_coordinates(cloud, coordinates)
    title = FORMATS[codec.name].title
    is_left = coordinates == "float32"
    return cloud, [f"{title} has coordinates of its own type, so they were not moved for float32."] if is_left else []


def format_to_write(path: str | os.PathLike[str], came_as: str) -> str:
    """Return the format of a file that is to be written at `path`: by its extension, else `came_as`.

    Raises
    ------
    FormatError
        ``unwritten_format`` if files with this extension are only read.
    """
    suffix = Path(path).suffix.lower()
    if suffix in UNWRITTEN_SUFFIXES:
        raise FormatError(
            f"Files that end in {suffix} cannot be written.",
            code="unwritten_format",
            hint="Name the result .ply: it also holds the faces of a mesh.",
        )
    if suffix in ANY_COLUMNS and came_as in _LAYOUTS:
        return came_as
    return SUFFIXES.get(suffix, came_as)


def _storable(cloud: PointCloud, codec: Codec) -> tuple[PointCloud, list[str]]:
    """Return the cloud as its rows go into a file: with holes if the format has them, in the order of the format."""
    whole, notes = cloud.whole(), []
    if codec.name != "ply" and isinstance(cloud.flavour, PlyFlavour) and (cloud.flavour.before or cloud.flavour.after):
        names = ", ".join(shown(block.name) for block in (*cloud.flavour.before, *cloud.flavour.after))
        notes.append(f"{FORMATS[codec.name].title} holds points only; left out were: {names}.")
    if not codec.holds_holes and cloud.holes is not None:
        finite = np.flatnonzero(np.isfinite(whole.points).all(axis=1))
        lost = len(whole) - len(finite)
        if lost:
            notes.append(
                f"{FORMATS[codec.name].title} has no place for rows without coordinates; {lost} were left out."
            )
            whole = whole.only(finite)
    ordered, told = codec.arrange(whole)
    return ordered, notes + told


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """Open a new file that replaces `path` if the block succeeds; after an error nothing of the new file is left.

    Raises
    ------
    OSError
        When the disk refuses.
    """
    target = Path(path)
    temporary = target.with_name(f".pcdnf-{secrets.token_hex(8)}.tmp")
    try:
        with temporary.open("x+b") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(target)
    except BaseException:
        with suppress(FileNotFoundError):
            temporary.unlink()
        raise
    _sync_folder(target.parent)


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
