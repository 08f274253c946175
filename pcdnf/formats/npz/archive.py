"""The zip container of an NPZ, read by ourselves: every size checked first, every byte counted.

Only what ``numpy.savez`` writes is accepted: one disk, stored or deflated members, no encryption, no
comment, no zip64 directory. PKWARE APPNOTE 6.3, sections 4.3 and 4.4.
"""

from __future__ import annotations

import struct
from dataclasses import replace
from typing import BinaryIO, NoReturn

from ..errors import FormatError, shown
from ..limits import Limits
from .inflate import Member, corrupt

MAX_MEMBERS = 64
"""Members besides our own metadata."""
MAX_NOTES = 32
"""Members named ``pcdnf_…``: metadata of an earlier denoising."""
MAX_NAME_BYTES = 128
MAX_RATIO = 100
"""Bytes a byte of the archive may inflate to, beyond the first ``FREE_BYTES``; measured points reach 4."""
FREE_BYTES = 16 * 1024**2

NOTE_PREFIX = "pcdnf_"

_MAX_DIRECTORY_BYTES = 64 * 1024
_END = struct.Struct("<4s4H2IH")
_ENTRY = struct.Struct("<4s6H3I5H2I")
_LOCAL = struct.Struct("<4s5H3I2H")
_LOCATOR_BYTES = 20  # of the zip64 end record, which stands before the end record
_STORED, _DEFLATED = 0, 8
_ENCRYPTED = 0x2041  # flag bits 0, 6, 13
_UTF8 = 0x0800


def read_directory(file: BinaryIO, size: int, limits: Limits) -> list[Member]:
    """List the members of an NPZ of `size` bytes, without inflating any.

    Raises
    ------
    FormatError
        With the code of what is wrong with the container.
    """
    directory, count, start = _directory(file, size)
    members: list[Member] = []
    position = 0
    for _ in range(count):
        member, position = _entry(directory, position)
        members.append(member)
    if position != len(directory):
        corrupt("its directory has another size than it declares")
    _check_names(members)
    _check_sizes(members, size, limits)
    return _located(file, members, start)


def _directory(file: BinaryIO, size: int) -> tuple[bytes, int, int]:
    """Return the central directory, its number of entries and its offset."""
    reach = min(size, _END.size + 0xFFFF)
    file.seek(size - reach)
    tail = file.read(reach)
    found = tail.rfind(b"PK\x05\x06")
    if found < 0 or len(tail) - found < _END.size:
        raise FormatError(
            f"The NPZ ends after {size} bytes without a directory of its members.",
            code="truncated",
            hint="The file is cut off: copy or export it again.",
        )
    _, disk, first_disk, here, count, length, start, _ = _END.unpack_from(tail, found)
    has_locator = tail[max(found - _LOCATOR_BYTES, 0) : found].startswith(b"PK\x06\x07")
    if has_locator or 0xFFFF in (here, count) or 0xFFFFFFFF in (length, start):
        _zip64()
    end = size - len(tail) + found + _END.size
    if end != size:
        raise FormatError(
            f"The NPZ ends after {end} bytes; the file has {size}.",
            code="trailing_data",
            hint="Remove what follows the archive, or save it again with numpy.savez.",
            limit=end,
            actual=size,
        )
    if disk or first_disk or here != count or start + length + _END.size != size:
        corrupt("its directory is not where it says")
    if count > MAX_MEMBERS + MAX_NOTES or length > _MAX_DIRECTORY_BYTES:
        _too_many(count)
    file.seek(start)
    return file.read(length), count, start


def _zip64() -> NoReturn:
    raise FormatError(
        "The NPZ uses the zip extension for 4 GiB and more.",
        code="unsupported_zip64",
        hint="Save fewer points, or save them as a binary PLY.",
    )


def _too_many(count: int) -> NoReturn:
    raise FormatError(
        f"The NPZ has {count} members; at most {MAX_MEMBERS} are read.",
        code="too_many_members",
        hint="Save only the arrays that belong to the points.",
        limit=MAX_MEMBERS,
        actual=count,
    )


def _entry(directory: bytes, position: int) -> tuple[Member, int]:
    """Return the entry of the directory at `position`, and the position of the next one."""
    if position + _ENTRY.size > len(directory):
        corrupt("its directory ends inside an entry")
    fields = _ENTRY.unpack_from(directory, position)
    flags, method, checksum, packed, size = fields[3], fields[4], *fields[7:10]
    name_length, extra_length, comment_length, offset = *fields[10:13], fields[16]
    if fields[0] != b"PK\x01\x02":
        corrupt("its directory holds something that is no entry")
    position += _ENTRY.size
    raw = directory[position : position + name_length]
    extra = directory[position + name_length : position + name_length + extra_length]
    name = _array_name(raw, bool(flags & _UTF8))
    if 0xFFFFFFFF in (packed, size, offset) or _has_zip64(extra):
        _zip64()
    if flags & _ENCRYPTED:
        raise FormatError(
            f"Member {shown(name)} of the NPZ is encrypted.",
            code="encrypted_archive",
            hint="Save it without a password.",
        )
    if method not in (_STORED, _DEFLATED):
        raise FormatError(
            f"Member {shown(name)} of the NPZ is compressed by method {method}; only deflate is read.",
            code="unsupported_compression",
            hint="Save it with numpy.savez or numpy.savez_compressed.",
        )
    if method == _STORED and packed != size:
        corrupt(f"member {shown(name)} is stored as {packed} bytes and declares {size}")
    member = Member(name, method == _DEFLATED, checksum, packed, size, offset)
    return member, position + name_length + extra_length + comment_length


def _has_zip64(extra: bytes) -> bool:
    position = 0
    while position + 4 <= len(extra):
        kind, length = struct.unpack_from("<HH", extra, position)
        if kind == 1:
            return True
        position += 4 + length
    return False


def _array_name(raw: bytes, is_utf8: bool) -> str:
    name = raw.decode("utf-8" if is_utf8 else "cp437", "replace")
    stem = name.removesuffix(".npy")
    legal = stem not in ("", ".", "..") and stem.isprintable() and not any(mark in stem for mark in "/\\:�")
    if stem == name or not legal or len(raw) > MAX_NAME_BYTES:
        raise FormatError(
            f"The NPZ has a member named {shown(name)}; arrays are named `<name>.npy`, without folders.",
            code="bad_member_name",
            hint="Save the arrays with numpy.savez(path, points=…), nothing nested.",
        )
    return stem


def _check_names(members: list[Member]) -> None:
    names = [member.name for member in members]
    twice = next((name for index, name in enumerate(names) if name in names[:index]), None)
    if twice is not None:
        raise FormatError(
            f"The NPZ has two members named {shown(twice)}.",
            code="duplicate_member",
            hint="Save each array once.",
        )
    notes = sum(name.startswith(NOTE_PREFIX) for name in names)
    if len(names) - notes > MAX_MEMBERS or notes > MAX_NOTES:
        _too_many(len(names))


def _check_sizes(members: list[Member], size: int, limits: Limits) -> None:
    total = sum(member.size for member in members)
    if total > limits.max_bytes:
        raise FormatError(
            f"The NPZ inflates to {total} bytes; the limit is {limits.max_bytes}.",
            code="file_too_large",
            hint="Save fewer points or fewer arrays.",
            limit=limits.max_bytes,
            actual=total,
        )
    if total > FREE_BYTES + MAX_RATIO * size:
        raise FormatError(
            f"The NPZ has {size} bytes and inflates to {total}, far more than measured points do.",
            code="compression_ratio",
            hint="Leave out constant arrays, or save without compression.",
            limit=FREE_BYTES + MAX_RATIO * size,
            actual=total,
        )


def _located(file: BinaryIO, members: list[Member], directory_start: int) -> list[Member]:
    """Members with the place of their bytes, none of which may overlap another's."""
    located: dict[str, Member] = {}
    end = 0
    for member in sorted(members, key=lambda member: member.offset):
        if member.offset < end or member.offset + _LOCAL.size > directory_start:
            corrupt(f"member {shown(member.name)} overlaps something else")
        file.seek(member.offset)
        signature, *_, name_length, extra_length = _LOCAL.unpack(file.read(_LOCAL.size))
        name = file.read(name_length).removesuffix(b".npy")
        if signature != b"PK\x03\x04" or name not in (
            member.name.encode(),
            member.name.encode("cp437", "replace"),
        ):
            corrupt(f"what lies at the place of member {shown(member.name)} is something else")
        start = member.offset + _LOCAL.size + name_length + extra_length
        end = start + member.packed
        if end > directory_start:
            corrupt(f"member {shown(member.name)} reaches beyond the data")
        located[member.name] = replace(member, start=start)
    return [located[member.name] for member in members]
