"""Coordinates in degrees with heights in metres: no distance between such points means anything."""

from __future__ import annotations

import re
import struct

import numpy as np

from .errors import FormatError
from .flavours import E57Flavour, LasFlavour
from .limits import Array
from .point_cloud import PointCloud

HINT = (
    "Reproject the cloud to a coordinate system in metres, such as UTM (pdal translate with filters.reprojection), or "
    "remove the coordinate system from the file if its coordinates are metres."
)
_WIDEST, _HIGHEST = 180.0, 90.0
_TALL = 200.0
"""Height over width beyond which a narrow cloud far from the origin must be degrees and metres."""
_FAR = 100.0
"""Distance of its middle from the origin, in its widths."""
_SAMPLE = 100_000
_PROJECTION = b"LASF_Projection"
_WKT, _GEO_KEYS = 2112, 34735
_MODEL_TYPE, _GEOGRAPHIC = 1024, 2
_PROJECTED = re.compile(r"\b(PROJCS|PROJCRS|PROJECTEDCRS|GEOCCS|LOCAL_CS|ENGCRS)\s*\[", re.IGNORECASE)
_ANGULAR = re.compile(r"\b(GEOGCS|GEOGCRS|GEOGRAPHICCRS)\s*\[|\bCS\s*\[\s*ellipsoidal", re.IGNORECASE)


def check_metric(cloud: PointCloud) -> None:
    """Raise ``geographic_coordinates`` if the coordinates are degrees, by the file's coordinate system or their looks.

    Raises
    ------
    FormatError
    """
    if is_declared_geographic(cloud) and within_degrees(cloud.points):
        raise FormatError(
            "The file's coordinate system is geographic: x and y are degrees, heights are not.",
            code="geographic_coordinates",
            hint=HINT,
        )
    if looks_geographic(cloud.points):
        raise FormatError(
            "The coordinates look like degrees with heights in metres: they fit longitude and latitude, and the cloud "
            "is hundreds of times as tall as it is wide.",
            code="geographic_coordinates",
            hint=HINT,
        )


def is_declared_geographic(cloud: PointCloud) -> bool:
    """Whether a LAS, LAZ or E57 declares longitude and latitude, as EPSG:4326 does.

    Coordinates of an E57 are metres by its standard. Its system counts where the cloud is narrower than one unit.
    """
    flavour = cloud.flavour
    if isinstance(flavour, E57Flavour):
        narrow = len(cloud) > 0 and float(np.ptp(cloud.points[:, :2], axis=0).max()) < 1
        return narrow and _is_angular(flavour.coordinate_system)
    if not isinstance(flavour, LasFlavour):
        return False
    for record in flavour.records:
        if record.user.rstrip(b"\0") != _PROJECTION:
            continue
        if record.number == _WKT and _is_angular(record.data.decode("utf-8", "replace")):
            return True
        if record.number == _GEO_KEYS and _model_type(record.data) == _GEOGRAPHIC:
            return True
    return False


def _is_angular(text: str) -> bool:
    return bool(_ANGULAR.search(text)) and not _PROJECTED.search(text)


def _model_type(data: bytes) -> int | None:
    """Return the value of GTModelTypeGeoKey among the keys of a GeoTIFF, each four uint16 after a head of four."""
    words = struct.unpack(f"<{len(data) // 2}H", data[: len(data) // 2 * 2])
    keys = zip(words[4::4], words[5::4], words[7::4], strict=False)
    return next((value for key, place, value in keys if key == _MODEL_TYPE and place == 0), None)


def within_degrees(points: Array) -> bool:
    """Whether x and y of points (N, 3) fit longitude and latitude, in either order."""
    largest = np.abs(points[:, :2]).max(axis=0) if len(points) else np.zeros(2)
    return bool(largest.max() <= _WIDEST and largest.min() <= _HIGHEST)


def looks_geographic(points: Array) -> bool:
    """Whether points (N, 3) fit degrees, are hundreds of times as tall as wide, and lie far from the origin.

    Rows that are not finite and far outliers do not count.
    """
    some = np.asarray(points[:: max(1, len(points) // _SAMPLE)], np.float64)
    some = some[np.isfinite(some).all(axis=1)]
    if not len(some):
        return False
    low, middle, high = np.quantile(some, (0.05, 0.5, 0.95), axis=0)
    if not within_degrees(np.stack([low, high])):
        return False
    spans = high - low
    wide = float(spans[:2].max())
    return bool(0 < wide * _TALL < spans[2] and np.abs(middle[:2]).max() > _FAR * wide)
