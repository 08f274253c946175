"""The peers of a benchmark by their names; the truth chooses the parameters of filters."""

from __future__ import annotations

from collections.abc import Sequence

from ..errors import PcdnfError
from .choice import Choice
from .filters import NEIGHBOURS, Bilateral, Jet, Plane
from .methods import Method
from .peers import peer_methods
from .programs import PROGRAMS, program_choices

SCAN_PEERS = ("jet", "plane", "bilateral", *PROGRAMS, "pca")
"""Peers on scans."""


def with_programs(names: Sequence[str]) -> list[Method | Choice]:
    """Return the named peers on clean clouds with noise; parameters of programs are chosen by the truth.

    Raises
    ------
    PcdnfError
        See :func:`peer_methods`.
    """
    programs = program_choices()
    rows: list[Method | Choice] = []
    for name in names:
        rows += [programs[name]] if name in programs else peer_methods([name])
    return rows


def scan_peers(names: Sequence[str]) -> list[Method | Choice]:
    """Return the named peers on scans; every parameter is chosen by the truth.

    Raises
    ------
    PcdnfError
        ``unknown_peer``; ``missing_extra`` where a library is not installed.
    """
    choices = {
        "jet": Choice("CGAL jet, best k", tuple(Jet(k) for k in NEIGHBOURS)),
        "plane": Choice("PCA plane, best k", tuple(Plane(k) for k in NEIGHBOURS)),
        "bilateral": Choice("CGAL bilateral x 3, best k", tuple(Bilateral(k) for k in NEIGHBOURS[:-1])),
        **program_choices(),
    }
    rows: list[Method | Choice] = []
    for name in names:
        if name == "pca":
            rows.append(Choice("PCA normals, best k", tuple(peer_methods([name])), "normals"))
        elif name in choices:
            if name in ("jet", "bilateral"):
                peer_methods([name])  # is CGAL there?
            rows.append(choices[name])
        else:
            hint = f"Use some of {', '.join(SCAN_PEERS)}."
            raise PcdnfError(f"There is no peer for scans named {name!r}.", code="unknown_peer", hint=hint)
    return rows
