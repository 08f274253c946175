"""The fate of every field of a format when a result is written in the format of its input."""

from __future__ import annotations

from typing import Literal

Fate = Literal["carried", "recomputed", "warned", "replaced"]
"""As it came; derived anew from the points; left out with a sentence; put in place by the result's own value."""

FIELDS: dict[str, dict[str, Fate]] = {
    "PLY": {
        "format (encoding, byte order)": "carried",
        "comment": "carried",
        "obj_info": "carried",
        "element vertex: count": "recomputed",
        "element vertex: x y z": "replaced",
        "element vertex: normals": "replaced",
        "element vertex: other properties": "carried",
        "element vertex: lists": "warned",
        "other elements, such as faces": "carried",
        "other elements, where vertices are left out": "warned",
        "rows that the header does not declare": "warned",
    },
    "OBJ, OFF, STL (results are PLY)": {
        "vertices": "replaced",
        "colours and normals of vertices": "carried",
        "faces": "carried",
        "comments": "carried",
        "normals of corners and triangles, texture coordinates": "warned",
        "materials, groups, lines, curves": "warned",
        "colours of faces, marks of triangles": "warned",
    },
    "NPZ": {
        "points": "replaced",
        "normals": "replaced",
        "other arrays, per point or not": "carried",
        "order and names of members": "carried",
        "compression": "carried",
    },
    "PCD": {
        "comments": "carried",
        "VERSION": "replaced",
        "FIELDS, SIZE, TYPE, COUNT": "carried",
        "WIDTH, HEIGHT": "carried",
        "WIDTH, HEIGHT, where rows are left out": "warned",
        "VIEWPOINT": "carried",
        "POINTS": "recomputed",
        "DATA (encoding)": "carried",
        "padding": "recomputed",
        "zeros after the last point": "recomputed",
    },
    "XYZ, CSV": {
        "separator, newline, names, order of columns": "carried",
        "comments": "carried",
        "further columns, as spelled": "carried",
        "byte order mark": "recomputed",
    },
    "PTS": {
        "count": "recomputed",
        "intensity, colours": "carried",
        "counts of further scans": "warned",
        "normals of the result": "warned",
    },
    "PTX": {
        "columns, rows": "carried",
        "scanner position, axes, matrix": "carried",
        "intensity, colours": "carried",
        "points without a return": "carried",
        "normals of the result": "warned",
    },
    "LAS, LAZ": {
        "file source ID": "carried",
        "global encoding": "carried",
        "project ID": "carried",
        "version": "carried",
        "system identifier": "carried",
        "generating software": "carried",
        "creation day and year": "carried",
        "header size": "carried",
        "offset to point data": "recomputed",
        "number of variable-length records": "recomputed",
        "point format, record length": "recomputed",
        "legacy counts": "recomputed",
        "scale, offset": "carried",
        "scale, offset, where they are too coarse or do not reach": "warned",
        "bounds": "recomputed",
        "start of waveforms": "recomputed",
        "start and number of extended records": "recomputed",
        "counts": "recomputed",
        "GPS times of LAS 1.5": "carried",
        "variable-length records": "carried",
        "extended records": "carried",
        "extra dimensions with their descriptions": "carried",
        "all fields and bits of a point": "carried",
        "index of a COPC, under another name": "warned",
        "chunks of a LAZ": "recomputed",
    },
    "E57": {
        "coordinateMetadata": "carried",
        "guid of the file": "recomputed",
        "creationDateTime of the file": "carried",
        "images2D": "warned",
        "scan: guid, name, description": "carried",
        "scan: pose": "carried",
        "scan: intensityLimits, colorLimits, indexBounds": "carried",
        "scan: cartesianBounds, sphericalBounds": "recomputed",
        "scan: sensor, weather, times, originalGuids": "carried",
        "scan: pointGroupingSchemes and other binary parts": "warned",
        "scan: parts of other extensions": "warned",
        "point: cartesianX … or sphericalRange …": "replaced",
        "point: cartesianInvalidState 0 and 2": "carried",
        "point: cartesianInvalidState 1, a direction without a distance": "warned",
        "point: intensity, colours, row, column, return, time and their marks": "carried",
        "point: columns of other extensions": "warned",
    },
}
"""By format, then by field as its specification names it."""


def as_table() -> str:
    """Return the list as Markdown, a table a format."""
    parts = []
    for title, fields in FIELDS.items():
        rows = [f"| {name} | {fate} |" for name, fate in fields.items()]
        parts.append("\n".join([f"| {title} | |", "|---|---|", *rows]))
    return "\n\n".join(parts)
