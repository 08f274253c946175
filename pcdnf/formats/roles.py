"""The names that programs give to normals, colours and other known columns: one table for every format, both ways.

A name counts whatever its case. CloudCompare puts ``scalar_`` before the names of a PLY.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable

NORMALS = (
    ("nx", "ny", "nz"),
    ("normal_x", "normal_y", "normal_z"),
    ("normalx", "normaly", "normalz"),
    ("nor:normalx", "nor:normaly", "nor:normalz"),
)
"""Names of the three components of a normal, the first set found counts."""

NEW_NORMALS = (*NORMALS[:2], ("denoised_nx", "denoised_ny", "denoised_nz"))
"""Names for normals a file did not have; the later ones where it has only some of the first."""

CHANNELS = ("red", "green", "blue")
"""The names of colours in all formats but those that have names of their own."""

_TOGETHER = {"rgb", "rgba", "color", "colors", "colour", "colours"}
"""Names of a column that holds all channels of a colour, in an NPZ."""

COLOURS = (
    CHANNELS,
    ("r", "g", "b"),
    ("rf", "gf", "bf"),
    ("diffuse_red", "diffuse_green", "diffuse_blue"),
    ("colorred", "colorgreen", "colorblue"),
    ("color_red", "color_green", "color_blue"),
)
"""Names of the three channels of a colour, the first set found counts."""

SCAN_INDEX = "scan_index"
"""The column that says which scan a point is of, where a file holds several."""

SPLAT = {"f_dc_0", "scale_0", "rot_0", "opacity"}
"""Columns that only Gaussian splats have together."""

SCALARS = ("confidence", "displacement", "estimated_noise")
"""Columns that no program looks for by name: in a PLY they get ``scalar_``, which CloudCompare needs to show them."""

_SCALAR = "scalar_"
_KNOWN = {
    "intensity": ("intensity", "intensities"),
    "classification": ("classification", "label_class"),
    "gps_time": ("gps_time", "gpstime", "gps time"),
    "return_number": ("return_number", "returnnumber", "return number"),
    "number_of_returns": ("number_of_returns", "numberofreturns", "number of returns"),
    "point_source_id": ("point_source_id", "pointsourceid", "point source id"),
    "user_data": ("user_data", "userdata", "user data"),
    "scan_angle_rank": ("scan_angle_rank", "scananglerank", "scan angle rank"),
    "scan_direction_flag": ("scan_direction_flag", "scandirectionflag"),
    "edge_of_flight_line": ("edge_of_flight_line", "edgeofflightline"),
    **{name: (name,) for name in SCALARS},
}
_CANONICAL = {spelled: name for name, spellings in _KNOWN.items() for spelled in spellings}

Triple = tuple[str, str, str]

COORDINATES: Triple = ("x", "y", "z")


def complete_sets(names: Iterable[str], table: Iterable[Triple]) -> list[Triple]:
    """Every set of the table that ``names`` has all of, as spelled there, in the order of the table."""
    spelled: dict[str, str] = {}
    for name in names:
        spelled.setdefault(name.lower(), name)
    return [
        (spelled[first], spelled[second], spelled[third])
        for first, second, third in table
        if first in spelled and second in spelled and third in spelled
    ]


def find_coordinates(names: Iterable[str]) -> Triple | None:
    """Find the names of the coordinates, as spelled, those in lower case first; None without coordinates."""
    names = list(names)
    return COORDINATES if {*COORDINATES} <= {*names} else next(iter(complete_sets(names, (COORDINATES,))), None)


def find_normals(names: Iterable[str]) -> Triple | None:
    """Find the names of the normals among the names of a file's columns, as spelled; None without normals."""
    return next(iter(complete_sets(names, (*NORMALS, NEW_NORMALS[-1]))), None)


def stale_normals(names: Iterable[str]) -> list[str]:
    """Columns that are one more set of normals: wrong as soon as there are new ones."""
    return [name for triple in complete_sets(names, (*NORMALS, NEW_NORMALS[-1])) for name in triple]


def free_normals(names: Iterable[str], preferred: Triple = NORMALS[0]) -> Triple:
    """Names for new normals that none of a file's columns has."""
    taken = {name.lower() for name in names}
    candidates = (preferred, *NEW_NORMALS, *((f"{x}_{n}", f"{y}_{n}", f"{z}_{n}") for n in range(2, 99)
                  for x, y, z in NEW_NORMALS[-1:]))  # fmt: skip
    return next(one for one in candidates if taken.isdisjoint({part.lower() for part in one}))


def find_colours(names: Iterable[str]) -> Triple | None:
    """Find the names of the colours among the names of a file's columns, as spelled; None without colours."""
    names = list(names)
    plain = {name.lower().removeprefix(_SCALAR): name for name in reversed(names)}
    found = next(iter(complete_sets(plain, COLOURS)), None)
    return None if found is None else (plain[found[0]], plain[found[1]], plain[found[2]])


def canonical_name(name: str) -> str:
    """Return the name that formats with fixed fields use for a column: ``scalar_GpsTime`` is ``gps_time``."""
    return _CANONICAL.get(name.lower().removeprefix(_SCALAR), name)


def ply_name(name: str) -> str:
    """Return the name of a column that is new to a PLY: ``confidence`` is ``scalar_confidence``."""
    return f"{_SCALAR}{name}" if name.removeprefix("pcdnf_") in SCALARS else name


def column_name(prop: str, taken: Collection[str]) -> str:
    """Return the name of the column that a property of a PLY holds: that of :func:`ply_name` backwards, if free."""
    name = prop.removeprefix(_SCALAR)
    return name if ply_name(name) == prop and name not in taken else prop


def channels_of(name: str, values: int) -> tuple[str, ...]:
    """Return the names of the channels of a column with ``values`` values a point; none if it is no colour."""
    return (*CHANNELS, "alpha")[:values] if name.lower() in _TOGETHER and values in (3, 4) else ()
