"""Point-cloud files: PLY and NPZ, read by our own checked readers and written back as they came.

>>> from pcdnf.formats import read, write
>>> cloud = read("scan.ply")
>>> write("result.ply", cloud.replaced(points, normals, metadata={"device": "cpu"}))

Reading takes no memory on the word of a header, evaluates nothing and unpickles nothing. This package
does not import torch.
"""

from .cloud import Limits, NpzFlavour, PlyFlavour, PointCloud
from .errors import CODES, FormatError
from .files import read, sniff, write

__all__ = [
    "CODES",
    "FormatError",
    "Limits",
    "NpzFlavour",
    "PlyFlavour",
    "PointCloud",
    "read",
    "sniff",
    "write",
]
