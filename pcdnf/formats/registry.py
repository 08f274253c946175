"""The codec of each format."""

from __future__ import annotations

from functools import partial

from .codec import Codec, FileCodec
from .e57.codec import read_e57
from .e57.write import write_e57
from .las.codec import arranged, read_las, write_las
from .las.grid import COARSEST
from .npz.codec import read_npz, write_npz
from .pcd.codec import read_pcd, write_pcd
from .ply.codec import read_ply, write_ply
from .ptx.codec import read_ptx, write_ptx
from .xyz.codec import read_xyz
from .xyz.write import write_xyz

_GRID = 0.5 / COARSEST
"""Coordinates of a LAS move by half a step of a grid of at least so many steps between neighbours."""

CODECS: dict[str, Codec] = {
    codec.name: codec
    for codec in (
        FileCodec("ply", read_ply, write_ply),
        FileCodec("npz", read_npz, write_npz),
        FileCodec("pcd", read_pcd, write_pcd),
        FileCodec("xyz", read_xyz, partial(write_xyz, format_="xyz")),
        FileCodec("csv", read_xyz, partial(write_xyz, format_="csv")),
        FileCodec("pts", read_xyz, partial(write_xyz, format_="pts")),
        FileCodec("ptx", read_ptx, write_ptx),
        FileCodec("las", read_las, partial(write_las, compressed=False), holds_holes=False, rounding=_GRID),
        FileCodec("laz", read_las, partial(write_las, compressed=True), holds_holes=False, rounding=_GRID),
        FileCodec("e57", read_e57, write_e57),
    )
}
"""How each format of :data:`pcdnf.file_formats.FORMATS` is read and written."""

COPC = FileCodec(
    "laz",
    read_las,
    partial(write_las, compressed=True, copc=True),
    holds_holes=False,
    rounding=_GRID,
    arranger=arranged,
)
"""A LAZ whose name ends in :data:`COPC_ENDING`."""
COPC_ENDING = ".copc.laz"
