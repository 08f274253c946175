"""Tables: rows, columns, means, the best, and figures from elsewhere."""

from __future__ import annotations

import csv
from pathlib import Path

from pcdnf.benchmark.methods import Group
from pcdnf.benchmark.published import Figure, published_figures
from pcdnf.benchmark.runs import Row
from pcdnf.benchmark.tables import COLUMNS, best_pca, best_peer, markdown, write_csv


def row(cloud: str, level: float, method: str, group: Group, surface: float, angle: float = 10.0) -> Row:
    return Row(
        key=f"{cloud}{level}{method}",
        cloud=cloud,
        noise="gaussian",
        level=level,
        method=method,
        group=group,
        points=100,
        chamfer_distance=2 * surface,
        point_to_surface=surface,
        normal_mean=angle,
        normal_rms=angle + 1,
        seconds=surface,
    )


ROWS = [
    row("a", 1, "noisy", "input", 8),
    row("a", 1, "jet", "peer", 4),
    row("a", 1, "bilateral", "peer", 5),
    row("a", 1, "PCA, k = 24", "normals", 8, 7.0),
    row("a", 1, "PCA, k = 60", "normals", 8, 6.0),
    row("a", 1, "ours x 1", "ours", 3, 5.0),
    row("b", 1, "noisy", "input", 10),
    row("b", 1, "jet", "peer", 6),
    row("b", 1, "ours x 1", "ours", 4),
    row("b", 2, "noisy", "input", 20),
]


def test_the_best_of_each_group() -> None:
    peer, pca = best_peer(ROWS, "a", "gaussian", 1), best_pca(ROWS, "a", "gaussian", 1)
    assert peer is not None
    assert pca is not None
    assert (peer.method, pca.method) == ("jet", "PCA, k = 60")
    assert best_peer(ROWS, "b", "gaussian", 2) is None


def test_markdown_holds_means_ratios_and_blanks() -> None:
    lines = markdown(ROWS).splitlines()
    assert "| cloud | method | 1 % | 2 % |" in lines
    assert "| a | noisy | 16.00 / 8.00 |  |" in lines
    assert "| a | ours x 1 | **6.00** / **3.00** |  |" in lines
    assert "| a | *ours x 1, share of best peer* | 0.75 / 0.75 |  |" in lines
    assert "| b | noisy | 20.00 / 10.00 | **40.00** / **20.00** |" in lines
    assert "| mean over clouds | jet | 10.00 / 5.00 |  |" in lines
    assert not any(line.startswith("| mean over clouds | bilateral") for line in lines)  # b has none
    assert "| a | PCA, best k a level | 6.0 / 7.0 |  |" in lines
    assert not any("| PCA, k = 24 | 16" in line for line in lines)  # it moves no points
    assert "| jet | 5.0 |  |" in lines  # seconds


def test_figures_from_elsewhere_are_marked_and_count_as_peers() -> None:
    lines = markdown(
        ROWS, [Figure("score-based", "a", 1, 7.0, 2.0), Figure("score-based", "a", 0.5, 1, 1)]
    ).splitlines()
    assert "| a | score-based † | 7.00 / **2.00** |  |" in lines
    assert "| a | *ours x 1, share of best peer* | 0.86 / 1.50 |  |" in lines
    assert any(line.startswith("† measured elsewhere") for line in lines)
    assert "| cloud | method | 1 % | 2 % |" in lines  # a level nobody ran makes no column


def test_csv_has_a_line_a_row(tmp_path: Path) -> None:
    write_csv(tmp_path / "table.csv", ROWS)
    with (tmp_path / "table.csv").open() as file:
        lines = list(csv.reader(file))
    assert tuple(lines[0]) == COLUMNS
    assert len(lines) == len(ROWS) + 1
    assert lines[1][:5] == ["a", "gaussian", "1", "noisy", "input"]


def test_published_figures_belong_to_the_very_cloud(shared_data: Path) -> None:
    from pcdnf.benchmark.clouds import read_clouds

    clouds = read_clouds([shared_data / "fandisk.npy", shared_data / "bunny.npz"])
    found = published_figures(clouds)
    assert {(figure.method, figure.cloud) for figure in found} == {
        ("score-based", "fandisk"),
        ("DMRDenoise", "fandisk"),
        ("PD-Flow", "fandisk"),
    }
    assert published_figures([clouds[0].thinned(99_000)]) == []
