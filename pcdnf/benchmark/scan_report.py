"""The reports of a benchmark on scans: CSV, Markdown, pictures."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .scan_runs import ScanResults, ScanRow
from .scans import SCALE, UNITS, TrueScan

if TYPE_CHECKING:
    from .pictures import Panel

COLUMNS = (
    "scan", "unit", "method", "group", "points", "distance", "worse", "worse_by_sigma", "thin", "thin_worse", "angle",
    "seconds",
)  # fmt: skip


@dataclass(frozen=True)
class ScanReport:
    """Everything that is derived from rows and their scans.

    Attributes
    ----------
    results : ScanResults
    scans : sequence of TrueScan
    rows : sequence of ScanRow
    """

    results: ScanResults
    scans: Sequence[TrueScan]
    rows: Sequence[ScanRow]

    def write(self, *, pictures: bool) -> list[Path]:
        """Write all of it into the folder of the results; return the paths."""
        folder = self.results.folder
        with (folder / "scans.csv").open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(COLUMNS)
            writer.writerows([getattr(row, column) for column in COLUMNS] for row in self.rows)
        (folder / "scans.md").write_text(markdown(self.rows))
        written = [folder / "scans.csv", folder / "scans.md"]
        return written + (list(self._pictures(folder / "pictures")) if pictures else [])

    def _pictures(self, folder: Path) -> Iterator[Path]:
        """Of each scan: its errors before, after the best peer and after the last of ours."""
        from .pictures import Panel, draw_errors

        folder.mkdir(exist_ok=True)
        for truth in self.scans:
            rows = [row for row in self.rows if row.scan == truth.scan.name]
            peers = [row for row in rows if row.group == "peer" and row.worse is not None]
            ours = [row for row in rows if row.group == "ours"]
            shown = [row for row in rows if row.group == "input"]
            shown += [min(peers, key=lambda row: row.distance)] if peers else []
            panels = [self._panel(row, truth) for row in [*shown, *ours[-1:]]]
            good = ~truth.scan.mixed
            clean = Panel("clean", truth.scan.clean[good], truth.scan.normals[good], np.zeros(int(good.sum())))
            path = folder / f"{truth.scan.name}.png"
            most = 2.5 * SCALE * float(truth.before[good].mean())
            unit = UNITS.get(truth.scan.unit, truth.scan.unit)
            draw_errors(path, truth.scan.name, panels, f"distance to the true surface, {unit}", most, clean)
            yield path

    def _panel(self, row: ScanRow, truth: TrueScan) -> Panel:
        """Return the points of a result that have a truth, coloured by their distance from it."""
        from .pictures import Panel

        output = self.results.output(row, truth)
        good = ~truth.scan.mixed
        errors = SCALE * truth.errors(output)
        return Panel(row.method, output.points[good], truth.scan.normals[good], errors[good])


def markdown(rows: Sequence[ScanRow]) -> str:
    """Tables with the scans across and the methods down, one for each figure."""
    parts = [
        "# Simulated scans",
        _table(rows, "Mean distance to the true surface", lambda row: _number(row.distance), unit=True),
        _table(rows, "Points further away than before, by more than their own sigma, %", _harm),
        _table(rows, "Thin parts: mean distance to the true surface", lambda row: _number(row.thin), unit=True),
        _table(rows, "Thin parts: points further away by more than their sigma, %", lambda row: _share(row.thin_worse)),
        _table(rows, "Normals: mean error in degrees", lambda row: _number(row.angle), normals=True),
        _table(rows, "Parameter that the truth chose", lambda row: str(row.facts.get("chosen", ""))),
        _table(rows, "Points that came out", lambda row: str(row.points)),
        _table(rows, "Seconds", lambda row: f"{row.seconds:.1f}"),
    ]
    return "\n\n".join(parts) + "\n"


def _table(
    rows: Sequence[ScanRow],
    title: str,
    text: Callable[[ScanRow], str],
    *,
    unit: bool = False,
    normals: bool = False,
) -> str:
    scans = {row.scan: row.unit for row in rows}
    heads = [f"{scan} ({UNITS.get(of, of)})" if unit else scan for scan, of in scans.items()]
    lines = [f"## {title}", "", _line("method", *heads), "|" + "---|" * (1 + len(heads))]
    for method in dict.fromkeys(row.method for row in rows if normals or row.group != "normals"):
        cells = {row.scan: text(row) for row in rows if row.method == method}
        lines.append(_line(method, *(cells.get(scan, "") for scan in scans)))
    return "\n".join(lines)


def _harm(row: ScanRow) -> str:
    if row.worse is None or row.group == "input":
        return ""
    return f"{_share(row.worse)}, {_share(row.worse_by_sigma)}"


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}"


def _share(value: float | None) -> str:
    return "" if value is None else f"{100 * value:.1f}"


def _line(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"
