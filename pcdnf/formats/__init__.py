"""Checked readers and writers of point-cloud files; ``pcdnf.file_formats`` lists the formats.

>>> from pcdnf.formats import read, write
>>> cloud = read("scan.ply")
>>> write("result.ply", cloud.replaced(points, normals, metadata={"device": "cpu"}))

Readers check the sizes in a header before they allocate memory, evaluate nothing and unpickle nothing. This package
does not import torch.
"""

from .errors import CODES, FormatError
from .files import read, write
from .flavours import E57Flavour, LasFlavour, NpzFlavour, PcdFlavour, PlyFlavour, PtxFlavour, XyzFlavour
from .limits import Limits
from .point_cloud import PointCloud
from .signatures import sniff

__all__ = [
    "CODES",
    "E57Flavour",
    "FormatError",
    "LasFlavour",
    "Limits",
    "NpzFlavour",
    "PcdFlavour",
    "PlyFlavour",
    "PointCloud",
    "PtxFlavour",
    "XyzFlavour",
    "read",
    "sniff",
    "write",
]
