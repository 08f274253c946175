"""Figures measured elsewhere, on clouds that are the same to the last bit (``published.toml``)."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from .clouds import CleanCloud


@dataclass(frozen=True)
class Figure:
    """What a method reached on a cloud with Gaussian noise."""

    method: str
    cloud: str
    level: float
    chamfer_distance: float
    point_to_surface: float


def published_figures(clouds: Iterable[CleanCloud]) -> list[Figure]:
    """Return the published figures of these clouds, under the names that the clouds have here."""
    tables = tomllib.loads((Path(__file__).parent / "published.toml").read_text())
    names = {cloud.digest(): cloud.name for cloud in clouds}
    found = []
    for entry in tables["figures"]:
        name = names.get(tables["clouds"][entry["cloud"]])
        if name is not None:
            found.append(Figure(**entry | {"cloud": name}))
    return found
