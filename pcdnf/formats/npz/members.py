"""The members of an NPZ that hold a cloud."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..attributes import numeric_attributes
from ..flavours import NpzFlavour
from ..ply.columns import ROLE_MEMBERS, fresh_name
from ..point_cloud import PointCloud


def npz_members(cloud: PointCloud) -> tuple[dict[str, NDArray[Any]], list[str]]:
    """Everything a cloud carries as NPZ members, in the order and types of the file they came from.

    Metadata, comments and the like are text scalars named ``pcdnf_<key>``.

    Returns
    -------
    members : dict of str to array
    notes : list of str
        What an NPZ cannot carry: columns of words.
    """
    attributes, notes = numeric_attributes(cloud, "NPZ")
    flavour = cloud.flavour if isinstance(cloud.flavour, NpzFlavour) else None
    points_name = flavour.points if flavour else "points"
    points_dtype = np.dtype(flavour.points_dtype) if flavour else cloud.points.dtype
    if points_dtype.newbyteorder("=") != cloud.points.dtype:
        points_dtype = cloud.points.dtype
    members: dict[str, NDArray[Any]] = {points_name: cloud.points.astype(points_dtype, copy=False)}
    if cloud.normals is not None:
        stored = np.dtype(flavour.normals_dtype) if flavour and flavour.normals_dtype else points_dtype
        if stored.newbyteorder("=") != cloud.normals.dtype:
            stored = cloud.normals.dtype
        members["normals"] = cloud.normals.astype(stored, copy=False)
    reserved = set() if flavour else ROLE_MEMBERS
    for name, values in [*attributes.items(), *cloud.extras.items()]:
        legal = re.sub(r"[\x00-\x1f/\\]", "_", name) or "_"
        members[fresh_name(legal, members.keys() | reserved)] = values
    order = flavour.members if flavour else ()
    ordered = {name: members[name] for name in order if name in members} | members
    texts = {f"pcdnf_{key}": value for key, value in cloud.metadata.items()}
    for key, lines in (("comments", cloud.comments), ("obj_info", cloud.obj_info)):
        if lines:
            texts[f"pcdnf_{key}"] = "\n".join(lines)
    return ordered | {name: np.array(_printable(text)) for name, text in texts.items()}, notes


def _printable(text: str) -> str:
    """Text that UTF-32 can hold: bytes of a header that were not UTF-8 become Latin-1 letters."""
    return "".join(chr(ord(letter) - 0xDC00) if 0xDC80 <= ord(letter) <= 0xDCFF else letter for letter in text)
