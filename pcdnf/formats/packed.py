"""Clouds packed by gzip or in a zip archive: unpacked into a file, every byte counted as it comes."""

from __future__ import annotations

import os
import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import BinaryIO

from ..file_formats import READ_SUFFIXES, titles
from ..gzip_stream import MAGIC, GzipError, Inflater
from .errors import FormatError, shown
from .npz.archive import FREE_BYTES, MAX_RATIO

ZIP_MAGIC = b"PK\x03\x04"
GZIP_SUFFIX, ZIP_SUFFIX = ".gz", ".zip"
_CHUNK = 1 << 20
_ENCRYPTED = 0x1
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_NO_ZIP = (zipfile.BadZipFile, OSError, ValueError, struct.error, NotImplementedError, EOFError, IndexError)


def is_packed(file: BinaryIO) -> bool:
    """Return whether a file is packed by gzip, or a zip archive other than an NPZ; it is left at its beginning."""
    head = file.read(len(ZIP_MAGIC))
    file.seek(0)
    if head.startswith(MAGIC):
        return True
    if head != ZIP_MAGIC:
        return False
    try:
        with zipfile.ZipFile(file) as archive:
            return bool(_files(archive)) and not any(name.endswith(".npy") for name in archive.namelist())
    except _NO_ZIP:
        return False  # the reader of NPZ says what is wrong
    finally:
        file.seek(0)


@contextmanager
def unpacked(file: BinaryIO, name: str, max_bytes: int) -> Iterator[Path]:
    """Unpack the cloud of a packed file into a temporary file, and yield its path; the name keeps its extension.

    Parameters
    ----------
    file : seekable binary file
    name : str
        Of the packed file.
    max_bytes : int
        Most bytes of the cloud.

    Raises
    ------
    FormatError
        With the code of what is wrong.
    """
    with TemporaryDirectory(prefix="pcdnf-") as folder:
        path = Path(folder) / "cloud"
        with path.open("wb") as target:
            inner = unpack(file, name, target, max_bytes)
        yield path.rename(path.with_name(f"cloud{PurePosixPath(inner).suffix.lower()}"))


def unpack(file: BinaryIO, name: str, target: BinaryIO, max_bytes: int) -> str:
    """Unpack the cloud of a packed file into `target`, and return the name that the cloud has without the packing.

    Raises
    ------
    FormatError
        ``corrupt_archive``, ``truncated``, ``trailing_data``, ``file_too_large``, ``compression_ratio``,
        ``encrypted_archive``, ``unsupported_compression``, ``bad_member_name`` or ``too_many_members``.
    """
    size = os.fstat(file.fileno()).st_size
    counted = _Counted(target, size, max_bytes)
    if file.read(len(MAGIC)) == MAGIC:
        file.seek(0)
        _gunzip(file, counted)
        return name[: -len(GZIP_SUFFIX)] if name.lower().endswith(GZIP_SUFFIX) else name
    file.seek(0)
    try:
        with zipfile.ZipFile(file) as archive:
            member = _cloud(archive)
            counted.check(member.file_size)
            with closing(archive.open(member)) as stream:
                while piece := stream.read(_CHUNK):
                    counted.write(piece)
    except OSError:
        raise
    except (*_NO_ZIP, zlib.error) as error:
        raise FormatError(
            "The zip archive contradicts itself.",
            code="corrupt_archive",
            hint="The file is damaged: copy it or pack it again.",
        ) from error
    return PurePosixPath(member.filename).name


def _gunzip(file: BinaryIO, counted: _Counted) -> None:
    inflater = Inflater()
    try:
        while chunk := file.read(_CHUNK):
            for piece in inflater.feed(chunk):
                counted.write(piece)
        inflater.finish()
    except GzipError as error:
        raise FormatError(
            f"The file that gzip packed cannot be unpacked: {error}.",
            code=error.code,
            hint="The file is damaged: copy it or pack it again.",
        ) from error


class _Counted:
    """A file that takes no more bytes than are allowed."""

    def __init__(self, file: BinaryIO, packed: int, max_bytes: int) -> None:
        self._file, self._max_bytes, self._ratio_bytes = file, max_bytes, FREE_BYTES + MAX_RATIO * packed
        self._size = 0

    def write(self, piece: bytes) -> None:
        self._size += len(piece)
        self.check(self._size)
        self._file.write(piece)

    def check(self, size: int) -> None:
        if size > self._max_bytes:
            raise FormatError(
                f"The file unpacks to more than {self._max_bytes} bytes, the limit.",
                code="file_too_large",
                hint="Cut the cloud into parts, or thin it out.",
                limit=self._max_bytes,
                actual=size,
            )
        if size > self._ratio_bytes:
            raise FormatError(
                "The file unpacks to far more bytes than measured points do.",
                code="compression_ratio",
                hint="Send the cloud unpacked.",
                limit=self._ratio_bytes,
                actual=size,
            )


def _files(archive: zipfile.ZipFile) -> list[zipfile.ZipInfo]:
    """Return the members of an archive that a person has put there."""
    return [
        member
        for member in archive.infolist()
        if not member.is_dir()
        and not any(part.startswith((".", "__MACOSX")) for part in PurePosixPath(member.filename).parts)
    ]


def _cloud(archive: zipfile.ZipFile) -> zipfile.ZipInfo:
    """Return the one cloud of an archive."""
    clouds = [member for member in _files(archive) if PurePosixPath(member.filename).suffix.lower() in READ_SUFFIXES]
    if not clouds:
        raise FormatError(
            f"The zip archive holds no cloud: no member is named as {titles()}.",
            code="bad_member_name",
            hint="Put one cloud into it, such as scan.ply.",
        )
    if len(clouds) > 1:
        raise FormatError(
            f"The zip archive holds {len(clouds)} clouds, such as {shown(clouds[0].filename)}.",
            code="too_many_members",
            hint="Put one cloud into each archive, or send the clouds by themselves.",
            limit=1,
            actual=len(clouds),
        )
    (member,) = clouds
    if member.flag_bits & _ENCRYPTED:
        raise FormatError(
            "The zip archive is encrypted.", code="encrypted_archive", hint="Pack it again without a password."
        )
    if member.compress_type not in _METHODS:
        raise FormatError(
            f"The zip archive is compressed by method {member.compress_type}; only deflate is read.",
            code="unsupported_compression",
            hint="Pack it again with the usual method.",
        )
    return member
