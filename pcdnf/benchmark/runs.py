"""Runs of methods on noisy clouds: a line of ``results.jsonl`` for each, and the cloud; see :mod:`.ledger`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..metrics import score
from .choice import Choice, run_timed
from .clouds import CleanCloud
from .ledger import Ledger, digest_of, extent_of
from .methods import Group, Method, Output

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Row:
    """One method on one noisy cloud.

    Attributes
    ----------
    key : str
        Hash of the input and the method's identity; names the file in ``clouds/``.
    cloud, noise, level, method, group
        ``level`` is in per cent of the clean diagonal.
    points : int
        That came out.
    chamfer_distance, point_to_surface, normal_mean, normal_rms : float
        See :mod:`pcdnf.metrics`.
    seconds : float
        Wall time of the method alone.
    identity, facts : dict
    """

    key: str
    cloud: str
    noise: str
    level: float
    method: str
    group: Group
    points: int
    chamfer_distance: float
    point_to_surface: float
    normal_mean: float
    normal_rms: float
    seconds: float
    identity: dict[str, str] = field(default_factory=dict)
    facts: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Case:
    """A noisy cloud and what it was made from."""

    clean: CleanCloud
    noise: str
    level: float

    def points(self) -> Floats:
        """Return the noisy points."""
        return self.clean.noisy(self.level, self.noise)


def cases(clouds: Sequence[CleanCloud], noises: Sequence[str], levels: Sequence[float]) -> Iterator[Case]:
    """All of them, cloud by cloud; without noise there is only one kind of it."""
    for cloud in clouds:
        for noise in noises:
            for level in levels:
                if level > 0 or noise in (noises[0], "outliers"):
                    yield Case(cloud, noise, level)


class Results:
    """A folder of results; parameters and errors as of :class:`.ledger.Ledger`."""

    def __init__(self, folder: Path, *, fresh: bool = False) -> None:
        self.folder = folder
        self._ledger = Ledger(folder, "results.jsonl", Row, fresh=fresh)

    def run(
        self, case: Case, methods: Sequence[Method | Choice], *, report: Callable[[Row, bool], None] | None = None
    ) -> list[Row]:
        """Run all methods on one noisy cloud and return their rows in order.

        ``report`` is called with each row and whether it was computed just now.
        """
        points, clean = case.points(), case.clean
        digest, extent = digest_of(points, clean.points, clean.normals), extent_of(clean.points)
        rows = []
        for method in methods:
            row, new = self._ledger.row(digest, method, partial(_computed, case, points), extent)
            # the same input or model may have gone by another name
            row = replace(row, cloud=clean.name, noise=case.noise, level=case.level, method=method.name)
            rows.append(row)
            if report is not None:
                report(row, new)
        return rows

    def output(self, row: Row, clean: CleanCloud) -> Output:
        """Read the cloud of a row, in the clean cloud's unit."""
        return self._ledger.output(row.key, extent_of(clean.points))


def _computed(case: Case, points: Floats, method: Method | Choice, key: str) -> tuple[Row, Output]:
    clean = case.clean

    def error(output: Output) -> float:
        return score(output.points, None, clean.points, clean.normals).point_to_surface

    output, seconds = run_timed(method, points, case.level, error)
    scores = score(output.points, output.normals, clean.points, clean.normals)
    assert scores.normal_mean is not None
    assert scores.normal_rms is not None
    row = Row(
        key=key,
        cloud=clean.name,
        noise=case.noise,
        level=case.level,
        method=method.name,
        group=method.group,
        points=scores.points,
        chamfer_distance=scores.chamfer_distance,
        point_to_surface=scores.point_to_surface,
        normal_mean=scores.normal_mean,
        normal_rms=scores.normal_rms,
        seconds=round(seconds, 2),
        identity=method.identity,
        facts=output.facts,
    )
    return row, output
