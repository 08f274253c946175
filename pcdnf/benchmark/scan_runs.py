"""Runs of methods on scans: a line of ``scans.jsonl`` each, and the cloud; see :mod:`.ledger`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from .choice import Choice, run_timed
from .ledger import Ledger, digest_of, extent_of
from .methods import Group, Method, Output
from .scans import TrueScan


@dataclass(frozen=True, kw_only=True)
class ScanRow:
    """One method on one scan; see :class:`.scans.ScanScore` for the figures."""

    key: str
    scan: str
    unit: str
    method: str
    group: Group
    distance: float
    worse: float | None
    worse_by_sigma: float | None
    thin: float | None
    thin_worse: float | None
    angle: float
    points: int
    seconds: float
    facts: dict[str, Any] = field(default_factory=dict)


class ScanResults:
    """A folder of results; parameters and errors as of :class:`.ledger.Ledger`."""

    def __init__(self, folder: Path, *, fresh: bool = False) -> None:
        self.folder = folder
        self._ledger = Ledger(folder, "scans.jsonl", ScanRow, fresh=fresh)

    def run(
        self,
        truth: TrueScan,
        methods: Sequence[Method | Choice],
        *,
        report: Callable[[ScanRow, bool], None] | None = None,
    ) -> list[ScanRow]:
        """Return the rows of all methods on one scan, in their order; ``report`` as of :meth:`.runs.Results.run`."""
        scan = truth.scan
        digest, extent = digest_of(scan.points, scan.scene.vertices, scan.sigma), extent_of(scan.points)
        rows = []
        for method in methods:
            row, new = self._ledger.row(digest, method, partial(_computed, truth), extent)
            row = replace(row, scan=scan.name, method=method.name)
            rows.append(row)
            if report is not None:
                report(row, new)
        return rows

    def output(self, row: ScanRow, truth: TrueScan) -> Output:
        """Return the cloud that a row is about."""
        return self._ledger.output(row.key, extent_of(truth.scan.points))


def _computed(truth: TrueScan, method: Method | Choice, key: str) -> tuple[ScanRow, Output]:
    error = (lambda output: truth.score(output).angle) if method.group == "normals" else truth.distance
    output, seconds = run_timed(method, truth.scan.points, 0.0, error)
    row = ScanRow(
        key=key,
        scan=truth.scan.name,
        unit=truth.scan.unit,
        method=method.name,
        group=method.group,
        seconds=round(seconds, 2),
        facts=output.facts,
        **asdict(truth.score(output)),
    )
    return row, output
