"""Where the scanner stood, for formats that say so: surfaces face it, which decides the side of normals."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .flavours import E57Flavour, PcdFlavour, PtxFlavour
from .point_cloud import Flavour, PointCloud
from .roles import SCAN_INDEX

_GRID = {"rowIndex", "columnIndex"}
_SPHERICAL = "sphericalRange"


Position = tuple[float, float, float]


def scanner_places(cloud: PointCloud, sensor: Position | None = None) -> NDArray[np.float64] | None:
    """Return where the scanner stood that saw each point.

    Scans on a grid tell: those of a PTX, of an E57 with rows and columns or spherical coordinates, and an organised
    PCD with its viewpoint. Other clouds may have been joined from many places.

    Parameters
    ----------
    cloud : PointCloud
    sensor : tuple of three floats, optional
        Where the caller says that it stood; counts before what the file says.

    Returns
    -------
    (N, 3) float64 array or None
        NaN for scans that do not tell; None where no scan does.
    """
    if sensor is not None:
        return np.broadcast_to(np.asarray(sensor, np.float64), (len(cloud), 3))
    places = _places(cloud.flavour)
    index = cloud.attributes.get(SCAN_INDEX)
    if not len(places) or np.isnan(places).all() or (len(places) > 1 and index is None):
        return None
    rows = np.zeros(len(cloud), np.int64) if index is None or len(places) == 1 else index.astype(np.int64)
    found: NDArray[np.float64] = places[rows]
    return found


def towards_scanner(cloud: PointCloud, sensor: Position | None = None) -> NDArray[np.float64] | None:
    """Return the directions from points to the scanner that saw them; see :func:`scanner_places`.

    Returns
    -------
    (N, 3) float64 array or None
        Of unit length, NaN for scans that do not tell; None where no scan does.
    """
    places = scanner_places(cloud, sensor)
    if places is None:
        return None
    ways: NDArray[np.float64] = places - cloud.points
    lengths = np.linalg.norm(ways, axis=1, keepdims=True)
    units: NDArray[np.float64] = np.divide(ways, lengths, out=np.full_like(ways, np.nan), where=lengths > 0)
    return units


def _places(flavour: Flavour) -> NDArray[np.float64]:
    """Return the position of each scan in the common frame, (scans, 3); NaN if it is not known."""
    places: list[tuple[float, ...]] = []
    unknown = (np.nan,) * 3
    if isinstance(flavour, PtxFlavour):
        places = [tuple(scan.matrix()[3]) if min(scan.columns, scan.rows) > 1 else unknown for scan in flavour.scans]
    elif isinstance(flavour, E57Flavour):
        fields = [{field.name for field in scan.fields} for scan in flavour.scans]
        known = [names >= _GRID or _SPHERICAL in names for names in fields]
        places = [scan.translation if one else unknown for scan, one in zip(flavour.scans, known, strict=True)]
    elif isinstance(flavour, PcdFlavour) and flavour.height > 1:
        places = [tuple(float(word) for word in flavour.viewpoint.split()[:3])]
    return np.array(places, np.float64).reshape(-1, 3)


def known_sides(cloud: PointCloud, sensor: Position | None = None) -> NDArray[np.floating] | None:
    """Return the normals of the file, else directions to its scanner, (N, 3): the side that new normals take."""
    return towards_scanner(cloud, sensor) if cloud.normals is None else cloud.normals
