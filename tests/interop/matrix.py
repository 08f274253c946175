"""What readers find in results, and ours in files of others: ``python -m tests.interop.matrix`` prints both tables."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from pcdnf.formats import PointCloud, read, write
from pcdnf.formats.attributes import renamed
from pcdnf.formats.colours import colours_of
from tests.interop.peers import PEERS, Array, Found, Peer
from tests.interop.writers import WRITERS, Write

COUNT = 1500
PARTS = ("points", "normals", "colours", "intensity", "time", "classes")
GEOREFERENCED = np.array([500_000.0, 5_400_000, 100])
NO_PLACE = {
    "ply": (),
    "pcd": (),
    "pts": ("normals", "time", "classes"),
    "las": (),
    "laz": (),
    "copc.laz": (),
    "e57": ("time", "classes"),
    "xyz": (),
    "csv": (),
}
"""What a format itself has no place for."""


def cloud(offset: Array) -> PointCloud:
    """A sphere with all kinds of columns."""
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(COUNT, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    colours = rng.integers(0, 256, (COUNT, 3)).astype(np.uint8)
    return PointCloud(
        points=normals * 5 + offset,
        normals=normals.astype(np.float32),
        attributes={
            **dict(zip(("red", "green", "blue"), colours.T, strict=True)),
            "intensity": rng.integers(0, 65536, COUNT).astype(np.uint16),
            "gps_time": 3e8 + np.arange(COUNT) * 1e-6,
            "classification": rng.integers(0, 19, COUNT).astype(np.uint8),
        },
    )


def verdicts(peer: Peer, ending: str, given: PointCloud, folder: Path) -> dict[str, str]:
    """For each part of the cloud: ``yes``, how far off, ``-`` where it was not found, or the error of the reader."""
    path = folder / f"cloud.{ending}"
    write(path, given, format=ending.rpartition(".")[2], check=True)
    try:
        found = peer.read(path)
    except Exception as error:  # whatever a foreign reader raises is its verdict
        return {"points": f"fails: {type(error).__name__}"}
    if len(found.points) != len(given):
        return {"points": f"{len(found.points)} points"}
    order = np.arange(len(given))
    if ending == "copc.laz":  # its points have an order of their own
        order = cKDTree(given.points).query(found.points)[1]
    return {part: _verdict(part, given, found, order) for part in PARTS if part not in NO_PLACE[ending]}


def reading(write_cloud: Write, ending: str, given: PointCloud, folder: Path) -> dict[str, str]:
    """For each part of the cloud: what our reader finds of it in a file of another program."""
    path = folder / f"foreign.{ending}"
    write_cloud(path, given)
    cloud = read(path)
    order = np.arange(len(given))
    if len(cloud) != len(given):
        return {"points": f"{len(cloud)} points"}
    if ending == "stl":  # its vertices have the order of its triangles
        order = cKDTree(given.points).query(cloud.points)[1]
    columns = renamed(cloud.attributes)
    colours = colours_of(columns)
    found = Found(
        cloud.points,
        cloud.normals,
        None if colours is None else colours.scaled(255),
        columns.get("intensity"),
        columns.get("gps_time"),
        columns.get("classification"),
    )
    return {part: _verdict(part, given, found, order) for part in PARTS}


def _verdict(part: str, given: PointCloud, found: Found, order: Array) -> str:
    values = getattr(found, part)
    if values is None:
        return "-"
    names = {"intensity": "intensity", "time": "gps_time", "classes": "classification"}
    wanted = {
        "points": given.points,
        "normals": given.normals,
        "colours": np.stack([given.attributes[one] for one in ("red", "green", "blue")], axis=1),
    }.get(part)
    wanted = given.attributes[names[part]] if wanted is None else wanted
    values, expected = values.astype(np.float64), wanted[order].astype(np.float64)
    if part == "colours" and values.max() > 255:
        values = values / 257
    off = float(np.nanmax(np.abs(values - expected)))
    close = {"points": 2e-3, "normals": 5e-3, "colours": 1.01, "time": 1e-7}.get(part, 1e-9)
    if part == "intensity" and off > close and np.abs(values * 65535 - expected).max() < 1:
        return "yes, 0..1"
    if values.min() == values.max() < expected.max():
        return "-"
    return "yes" if off <= close else f"off by {off:.2g}"


def table() -> str:
    """The matrix as Markdown: near the origin, then georeferenced."""
    lines = ["| Reader | Format | " + " | ".join(PARTS) + " | georeferenced |", "|" + "---|" * (len(PARTS) + 3)]
    with tempfile.TemporaryDirectory() as name:
        for peer in PEERS:
            for ending in peer.endings:
                if not peer.is_here:
                    lines.append(f"| {peer.name} | {ending} |" + " not installed |" * (len(PARTS) + 1))
                    continue
                near = verdicts(peer, ending, cloud(np.zeros(3)), Path(name))
                far = verdicts(peer, ending, cloud(GEOREFERENCED), Path(name))
                cells = [near.get(part, "no place" if part in NO_PLACE[ending] else "") for part in PARTS]
                lines.append(f"| {peer.name} {peer.version} | {ending} | {' | '.join(cells)} | {far['points']} |")
    return "\n".join(lines)


def table_of_writers() -> str:
    """What our readers find in files of other programs, as Markdown."""
    lines = ["| Writer | Format | " + " | ".join(PARTS) + " | georeferenced |", "|" + "---|" * (len(PARTS) + 3)]
    with tempfile.TemporaryDirectory() as name:
        for peer, write_cloud in WRITERS:
            for ending in peer.endings:
                if not peer.is_here:
                    lines.append(f"| {peer.name} | {ending} |" + " not installed |" * (len(PARTS) + 1))
                    continue
                near = reading(write_cloud, ending, cloud(np.zeros(3)), Path(name))
                far = reading(write_cloud, ending, cloud(GEOREFERENCED), Path(name))
                cells = [near.get(part, "") for part in PARTS]
                lines.append(f"| {peer.name} {peer.version} | {ending} | {' | '.join(cells)} | {far['points']} |")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.stdout.write(table() + "\n\n" + table_of_writers() + "\n")
