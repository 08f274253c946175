"""Results as CSV (one line a row) and Markdown (methods down, noise levels across, each cloud and their mean)."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean

from .published import Figure
from .runs import Row

COLUMNS = (
    "cloud",
    "noise",
    "level",
    "method",
    "group",
    "points",
    "chamfer_distance",
    "point_to_surface",
    "normal_mean",
    "normal_rms",
    "seconds",
)
MEAN = "mean over clouds"
BEST_PCA = "PCA, best k a level"
ELSEWHERE = "†"
"""Marks figures that were measured elsewhere."""

Pair = tuple[float, float]
Cells = dict[tuple[str, str, float], Pair]
"""(cloud, method, level) to two figures."""


def write_csv(path: Path, rows: Iterable[Row]) -> None:
    """All rows with all figures."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        writer.writerows([getattr(row, column) for column in COLUMNS] for row in rows)


@dataclass(frozen=True)
class _Table:
    """One noise kind's figures of one sort, with the methods in order."""

    cells: Cells
    clouds: list[str]
    levels: list[float]
    methods: list[str]

    def pair(self, cloud: str, method: str, level: float) -> Pair | None:
        """Return the figures of a cloud, or their means if every cloud has figures."""
        if cloud != MEAN:
            return self.cells.get((cloud, method, level))
        pairs = [self.cells.get((name, method, level)) for name in self.clouds]
        there = [pair for pair in pairs if pair is not None]
        if not there or len(there) < len(pairs):
            return None
        return fmean(pair[0] for pair in there), fmean(pair[1] for pair in there)

    def best(self, cloud: str, methods: Iterable[str], level: float) -> Pair | None:
        """Return the lowest of each figure among some methods."""
        there = [pair for pair in (self.pair(cloud, method, level) for method in methods) if pair is not None]
        return (min(pair[0] for pair in there), min(pair[1] for pair in there)) if there else None

    def sections(self) -> list[str]:
        """Return the clouds, and their mean if there are several."""
        return [*self.clouds, MEAN] if len(self.clouds) > 1 else self.clouds

    def lines(self, cloud: str, methods: Sequence[str], text: Callable[[Pair], str]) -> list[str]:
        """Markdown rows; the lowest of each figure is bold."""
        best = {level: self.best(cloud, methods, level) for level in self.levels}
        lines = []
        for method in methods:
            pairs = [self.pair(cloud, method, level) for level in self.levels]
            if any(pairs):
                texts = (
                    "" if pair is None else _bold(text(pair), pair, best[level])
                    for pair, level in zip(pairs, self.levels, strict=True)
                )
                lines.append(_line(cloud, method, *texts))
        return lines


def markdown(rows: Sequence[Row], figures: Sequence[Figure] = ()) -> str:
    """Write the report: distances with ratios to the best peer, normals and seconds for each kind of noise."""
    parts = []
    for noise in dict.fromkeys(row.noise for row in rows):
        chosen = [row for row in rows if row.noise == noise]
        parts += [f"## Noise: {noise}", _distances(chosen, figures if noise == "gaussian" else ())]
        parts += [_normals(chosen), _seconds(chosen)]
    return "\n\n".join(parts) + "\n"


def best_peer(rows: Iterable[Row], cloud: str, noise: str, level: float) -> Row | None:
    """Find the peer with the smallest distance to the surface."""
    peers = [row for row in rows if row.group == "peer" and (row.cloud, row.noise, row.level) == (cloud, noise, level)]
    return min(peers, key=lambda row: row.point_to_surface, default=None)


def best_pca(rows: Iterable[Row], cloud: str, noise: str, level: float) -> Row | None:
    """Find the PCA normals with the smallest mean error."""
    found = [
        row for row in rows if row.group == "normals" and (row.cloud, row.noise, row.level) == (cloud, noise, level)
    ]
    return min(found, key=lambda row: row.normal_mean, default=None)


def _table(rows: Sequence[Row], cells: Cells) -> _Table:
    return _Table(
        cells,
        list(dict.fromkeys(row.cloud for row in rows)),
        sorted({row.level for row in rows}),
        list(dict.fromkeys(method for _, method, _ in cells)),
    )


def _distances(rows: Sequence[Row], figures: Sequence[Figure]) -> str:
    cells: Cells = {
        (row.cloud, row.method, row.level): (row.chamfer_distance, row.point_to_surface)
        for row in rows
        if row.group != "normals"
    }
    ours = [row.method for row in rows if row.group == "ours"]
    peers = [row.method for row in rows if row.group == "peer"]
    table = _table(rows, cells)
    for figure in figures:
        name = f"{figure.method} {ELSEWHERE}"
        if figure.level in table.levels and figure.cloud in table.clouds:
            cells[figure.cloud, name, figure.level] = (figure.chamfer_distance, figure.point_to_surface)
            peers.append(name)
    ours, peers = list(dict.fromkeys(ours)), list(dict.fromkeys(peers))
    shown = [method for method in table.methods if method not in {*ours, *peers}] + peers + ours
    lines = [*_head("Chamfer distance x 1e5 / point-to-surface distance x 1e3", table.levels)]
    for cloud in table.sections():
        lines += table.lines(cloud, shown, lambda pair: f"{pair[0]:.2f} / {pair[1]:.2f}")
        for method in ours if peers else ():
            texts = []
            for level in table.levels:
                pair, best = table.pair(cloud, method, level), table.best(cloud, peers, level)
                texts.append(
                    "" if pair is None or best is None else f"{_ratio(pair, best, 0)} / {_ratio(pair, best, 1)}"
                )
            lines.append(_line(cloud, f"*{method}, share of best peer*", *texts))
    if any(method.endswith(ELSEWHERE) for method in peers):
        lines += ["", f"{ELSEWHERE} measured elsewhere with its authors' weights, not computed here."]
    return "\n".join(lines)


def _normals(rows: Sequence[Row]) -> str:
    cells: Cells = {
        (row.cloud, row.method, row.level): (row.normal_mean, row.normal_rms) for row in rows if row.group != "normals"
    }
    for row in rows:
        best = best_pca(rows, row.cloud, row.noise, row.level)
        if best is not None:
            cells[row.cloud, BEST_PCA, row.level] = (best.normal_mean, best.normal_rms)
    table = _table(rows, cells)
    lines = _head("Normal error, degrees up to sign, mean / RMS", table.levels)
    for cloud in table.sections():
        lines += table.lines(cloud, table.methods, lambda pair: f"{pair[0]:.1f} / {pair[1]:.1f}")
    return "\n".join(lines)


def _seconds(rows: Sequence[Row]) -> str:
    clouds = max(len({row.cloud for row in rows}), 1)
    lines = [f"Seconds a cloud, mean over {clouds} cloud{'s' if clouds > 1 else ''}", ""]
    levels = sorted({row.level for row in rows})
    lines += _header("method", *(f"{level:g} %" for level in levels))
    for method in dict.fromkeys(row.method for row in rows):
        texts = []
        for level in levels:
            taken = [row.seconds for row in rows if (row.method, row.level) == (method, level)]
            texts.append(f"{fmean(taken):.1f}" if taken else "")
        lines.append(_line(method, *texts))
    return "\n".join(lines)


def _ratio(pair: Pair, best: Pair, which: int) -> str:
    return f"{pair[which] / best[which]:.2f}" if best[which] > 0 else "–"


def _bold(text: str, pair: Pair, best: Pair | None) -> str:
    parts = text.split(" / ")
    assert best is not None
    return " / ".join(
        f"**{part}**" if value == least else part for part, value, least in zip(parts, pair, best, strict=True)
    )


def _head(title: str, levels: Sequence[float]) -> list[str]:
    return [title, "", *_header("cloud", "method", *(f"{level:g} %" for level in levels))]


def _header(*cells: str) -> list[str]:
    return [_line(*cells), "|" + "---|" * len(cells)]


def _line(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"
