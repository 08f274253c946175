"""Small valid files of every format, and changed copies of them."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from pcdnf.formats import NpzFlavour, PcdFlavour, PlyFlavour, PointCloud, write

KINDS = (
    "ply-ascii", "ply-binary_little_endian", "ply-binary_big_endian", "npz-stored", "npz-deflated", "pcd-ascii",
    "pcd-binary", "pcd-binary_compressed", "xyz", "csv", "pts", "ptx", "las", "laz", "laz-copc", "e57", "npz-array",
    "ply-lists", "mesh-obj", "mesh-off", "mesh-stl",
)  # fmt: skip
POINTS = 9


def seed(kind: str, folder: Path) -> bytes:
    """A small valid file with colours, attributes, comments and metadata."""
    rng = np.random.default_rng(0)
    format_, _, detail = kind.partition("-")
    flavours = {
        "ply": PlyFlavour("ascii" if detail == "lists" else detail),
        "npz": NpzFlavour(compressed=detail == "deflated"),
        "pcd": PcdFlavour(detail),
    }
    cloud = PointCloud(
        points=rng.normal(size=(POINTS, 3)),
        normals=rng.normal(size=(POINTS, 3)),
        attributes={
            **{name: np.arange(POINTS, dtype=np.uint8) for name in ("red", "green", "blue")},
            "tag": np.arange(POINTS, dtype=np.int32),
        },
        comments=["a comment"],
        metadata={"device": "cpu"},
        flavour=flavours.get(format_, PlyFlavour()),
    )
    if kind == "npz-array":
        np.save(folder / "seed.npy", np.array([tuple(row) for row in cloud.points], [(axis, "f4") for axis in "xyz"]))
        return (folder / "seed.npy").read_bytes()
    if kind == "ply-lists":
        return _with_lists(cloud)
    if format_ == "mesh":
        return _mesh(detail, cloud)
    name = "seed.copc.laz" if kind == "laz-copc" else "seed"
    write(folder / name, cloud, format=format_)
    return (folder / name).read_bytes()


def _with_lists(cloud: PointCloud) -> bytes:
    """A PLY whose vertices have lists, and with faces."""
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {POINTS}\nproperty float x\nproperty float y\n"
    head += (
        "property float z\nproperty list uchar ushort seen\nelement face 2\nproperty list uchar int at\nend_header\n"
    )
    rows = [struct.pack(f"<3fB{row % 4}H", *point, row % 4, *range(row % 4)) for row, point in enumerate(cloud.points)]
    return head.encode() + b"".join(rows) + struct.pack("<B3iB3i", 3, 0, 1, 2, 3, 2, 3, 4)


def _mesh(kind: str, cloud: PointCloud) -> bytes:
    """A mesh of triangles between points that follow each other."""
    faces = [(i, i + 1, i + 2) for i in range(POINTS - 2)]
    if kind == "stl":
        corners = [cloud.points[list(face)].ravel() for face in faces]
        facets = [struct.pack("<12fH", 0, 0, 1, *corner, 0) for corner in corners]
        return bytes(80) + struct.pack("<I", len(faces)) + b"".join(facets)
    rows = [" ".join(map(str, point)) for point in cloud.points.tolist()]
    if kind == "off":
        lines = ["OFF", f"{POINTS} {len(faces)} 0", *rows, *(f"3 {a} {b} {c}" for a, b, c in faces)]
    else:
        lines = ["# a comment", *(f"v {row}\nvn 0 0 1" for row in rows)]
        lines += [f"f {a + 1}//{a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    return "\n".join([*lines, ""]).encode()


def mutant(data: bytes, rng: np.random.Generator) -> bytes:
    """Bytes with a few changes; those of an E57 mostly with sound checksums, to get past the first check."""
    changed = _changed(data, rng)
    return with_checksums(changed) if data.startswith(b"ASTM-E57") and rng.random() < 0.9 else changed


def with_checksums(data: bytes) -> bytes:
    """Pages of an E57 with the checksums (CRC-32C) of what they hold now."""
    pages = [data[at : at + 1020].ljust(1020, b"\0") for at in range(0, len(data), 1024)]
    return b"".join(page + struct.pack(">I", crc32c(page)) for page in pages)


def crc32c(data: bytes) -> int:
    """The checksum of a page of an E57 (Castagnoli)."""
    value = 0xFFFFFFFF
    for octet in data:
        value = _TABLE[(value ^ octet) & 255] ^ (value >> 8)
    return value ^ 0xFFFFFFFF


def _row(value: int) -> int:
    for _ in range(8):
        value = (value >> 1) ^ (0x82F63B78 if value & 1 else 0)
    return value


_TABLE = [_row(value) for value in range(256)]


def _changed(data: bytes, rng: np.random.Generator) -> bytes:
    """Single values, cut or doubled spans, numbers blown up."""
    changed = bytearray(data)
    for _ in range(rng.integers(1, 5)):
        at, stop = sorted(rng.integers(0, max(1, len(changed)), 2).tolist())
        match int(rng.integers(8)):
            case 0:
                changed[at : at + 1] = bytes([int(rng.integers(256))])
            case 1:
                del changed[at : min(stop, at + 40)]
            case 2:
                changed[at:at] = changed[at : min(stop, at + 40)]
            case 3:
                changed[at : at + 4] = rng.choice([b"\xff" * 4, b"\0" * 4, b"\x7f\xff\xff\xff", b" nan", b"9999"])
            case 4:
                changed = bytearray(bytes(changed).replace(b"9", rng.choice([b"-9", b"9e9", b"99999999"]), 1))
            case 5:  # a number of the header
                at = int(rng.integers(0, min(400, len(changed)) + 1))
                value = rng.choice([0, 1, 2, 8, 10, 255, 65535, 2**31 - 1, 2**32 - 1])
                changed[at : at + 4] = struct.pack("<I", value)
            case 6:
                changed = changed[: max(4, stop)]
            case _:
                if changed:
                    changed[min(at, len(changed) - 1)] ^= 1 << int(rng.integers(8))
    return bytes(changed)
