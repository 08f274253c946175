"""The reports of a benchmark: tables, intervals of differences, pictures."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..geometry.normals import pca_normals
from ..metrics import CLEAN_NORMAL_NEIGHBOURS, PointErrors, point_errors
from .clouds import CleanCloud
from .intervals import paired_interval
from .published import published_figures
from .runs import Results, Row
from .tables import best_pca, best_peer, markdown, write_csv

if TYPE_CHECKING:
    from .pictures import Panel

REMEMBERED = 16
"""Rows whose point errors are held at once."""
ERROR_SCALE = 95
"""Percentile of the best peer's errors (ours without peers) at the end of the colour scale."""


@dataclass(frozen=True)
class Report:
    """Everything that is derived from rows and their clouds.

    Attributes
    ----------
    results : Results
    clouds : list of CleanCloud
    rows : list of Row
    """

    results: Results
    clouds: Sequence[CleanCloud]
    rows: Sequence[Row]
    _remembered: dict[str, PointErrors] = field(default_factory=dict, init=False, repr=False)

    def write(self, *, pictures: bool) -> list[Path]:
        """Write all of it into the folder of the results; return the paths."""
        folder = self.results.folder
        write_csv(folder / "table.csv", self.rows)
        (folder / "table.md").write_text(markdown(self.rows, published_figures(self.clouds)))
        (folder / "intervals.md").write_text(self.intervals())
        written = [folder / name for name in ("table.csv", "table.md", "intervals.md")]
        return written + (list(self._pictures(folder / "pictures")) if pictures else [])

    def intervals(self) -> str:
        """Differences of the distance to the surface: each of ours to the best peer and to ours before it."""
        lines = [
            "Difference of the point-to-surface distance x 1e3, first minus second, with its 95 % bootstrap interval",
            "(2 000 draws of cells of 5 % of the diagonal; below zero the first is nearer to the surface).",
            "",
            "| cloud | noise | level | first | second | difference | interval |",
            "|---|---|---|---|---|---|---|",
        ]
        for first, second in self._pairs():
            interval = paired_interval(
                self._errors(first).surface, self._errors(second).surface, self._clean(first).points
            )
            lines.append(
                f"| {first.cloud} | {first.noise} | {first.level:g} % | {first.method} | {second.method}"
                f" | {interval.mean:+.3f} | {interval.low:+.3f} to {interval.high:+.3f} |"
            )
        return "\n".join(lines) + "\n"

    def _pairs(self) -> Iterator[tuple[Row, Row]]:
        previous: Row | None = None
        for row in self.rows:
            if row.group != "ours":
                previous = None
                continue
            aligned = [other for other in self.rows if other.points == row.points]
            peer = best_peer(aligned, row.cloud, row.noise, row.level)
            if peer is not None:
                yield row, peer
            if previous is not None and _place(previous) == _place(row):
                yield row, previous
            previous = row

    def _clean(self, row: Row) -> CleanCloud:
        return next(cloud for cloud in self.clouds if cloud.name == row.cloud)

    def _errors(self, row: Row) -> PointErrors:
        """Of each point of a row; the last few are remembered."""
        if row.key not in self._remembered:
            while len(self._remembered) >= REMEMBERED:
                self._remembered.pop(next(iter(self._remembered)))
            output, clean = self.results.output(row, self._clean(row)), self._clean(row)
            self._remembered[row.key] = point_errors(output.points, output.normals, clean.points, clean.normals)
        return self._remembered[row.key]

    def _pictures(self, folder: Path) -> Iterator[Path]:
        """Curves for each kind of noise; for each noisy cloud its errors, best peer and last of ours beside it."""
        from .pictures import STEEPEST_ANGLE, draw_curves, draw_errors

        folder.mkdir(exist_ok=True)
        for noise in dict.fromkeys(row.noise for row in self.rows):
            draw_curves(folder / f"curves-{noise}.png", self.rows, noise)
            yield folder / f"curves-{noise}.png"
        for place in dict.fromkeys(_place(row) for row in self.rows if row.level > 0):
            cloud, noise, level = place
            here = [row for row in self.rows if _place(row) == place]
            noisy, ours = ([row for row in here if row.group == group] for group in ("input", "ours"))
            compared = [row for row in (best_peer(here, *place), *ours[-1:]) if row is not None]
            pca = best_pca(here, *place)
            title, clean = f"{cloud}, {level:g} % {noise} noise", self._model(here[0])
            stem = re.sub(r"[^\w.-]+", "-", f"{cloud}-{noise}-{level:g}")
            panels = [self._panel(row, "surface") for row in [*noisy, *compared]]
            most = float(np.percentile(panels[min(1, len(panels) - 1)].errors, ERROR_SCALE))
            path = folder / f"{stem}-surface.png"
            draw_errors(path, title, panels, "distance to the surface x 1e3 of the diagonal", most, clean)
            yield path
            panels = [self._panel(row, "angle") for row in [*([pca] if pca else noisy), *compared]]
            path = folder / f"{stem}-normals.png"
            draw_errors(path, title, panels, "normal error, degrees", STEEPEST_ANGLE, clean)
            yield path

    def _panel(self, row: Row, error: str) -> Panel:
        from .pictures import Panel

        output = self.results.output(row, self._clean(row))
        return Panel(row.method, output.points, output.normals, getattr(self._errors(row), error))

    def _model(self, row: Row) -> Panel:
        """Return the clean cloud, which decides the camera."""
        from .pictures import Panel

        clean = self._clean(row)
        normals = pca_normals(clean.points, CLEAN_NORMAL_NEIGHBOURS) if clean.normals is None else clean.normals
        return Panel("clean", clean.points, normals, np.zeros(len(clean.points)))


def _place(row: Row) -> tuple[str, str, float]:
    return row.cloud, row.noise, row.level
