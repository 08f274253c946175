"""Runs of methods on scans: a line of ``scans.jsonl`` each, and the cloud that came out; see :mod:`.runs`."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from .choice import Choice, run_timed
from .methods import Group, Method, Output
from .runs import append_line, cloud_folder, digest_of, key_of, read_lines, store_cloud
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
    """A folder of results.

    Parameters
    ----------
    folder : Path
        Made where it does not exist.
    fresh : bool
        Compute again what is there.

    Raises
    ------
    PcdnfError
        ``unwritable_folder``.
    """

    def __init__(self, folder: Path, *, fresh: bool = False) -> None:
        self.folder = folder
        self._clouds = cloud_folder(folder)
        self._file = folder / "scans.jsonl"
        self._known = {row.key: row for row in (ScanRow(**json.loads(line)) for line in read_lines(self._file))}
        self._fresh = fresh

    def run(
        self,
        truth: TrueScan,
        methods: Sequence[Method | Choice],
        *,
        report: Callable[[ScanRow, bool], None] | None = None,
    ) -> list[ScanRow]:
        """Return the rows of all methods on one scan, in their order."""
        scan = truth.scan
        digest = digest_of(scan.points, scan.scene.vertices, scan.sigma)
        rows = []
        for method in methods:
            key = key_of(digest, method.identity)
            row = None if self._fresh else self._known.get(key)
            new = row is None or not (self._clouds / f"{key}.npz").exists()
            if row is None or new:
                row = self._computed(truth, method, key)
                append_line(self._file, asdict(row))
                self._known[key] = row
            row = ScanRow(**vars(row) | {"scan": scan.name, "method": method.name})
            rows.append(row)
            if report is not None:
                report(row, new)
        return rows

    def output(self, row: ScanRow, truth: TrueScan) -> Output:
        """Return the cloud that a row is about."""
        low, size = _frame(truth)
        with np.load(self._clouds / f"{row.key}.npz", allow_pickle=False) as arrays:
            return Output(arrays["points"].astype(np.float64) * size + low, arrays["normals"])

    def _computed(self, truth: TrueScan, method: Method | Choice, key: str) -> ScanRow:
        error = (lambda output: truth.score(output).angle) if method.group == "normals" else truth.distance
        output, seconds = run_timed(method, truth.scan.points, 0.0, error)
        score, (low, size) = truth.score(output), _frame(truth)
        store_cloud(self._clouds, key, Output((output.points - low) / size, output.normals))
        return ScanRow(
            key=key,
            scan=truth.scan.name,
            unit=truth.scan.unit,
            method=method.name,
            group=method.group,
            seconds=round(seconds, 2),
            facts=output.facts,
            **asdict(score),
        )


def _frame(truth: TrueScan) -> tuple[Any, float]:
    points = truth.scan.points
    return points.min(0), float(np.linalg.norm(np.ptp(points, axis=0)))
