"""Pictures: errors in colour on the clouds, and curves over noise. Needs the extra ``benchmark`` (matplotlib)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..render.camera import Camera, automatic
from ..render.splats import visible
from .runs import Row
from .tables import BEST_PCA, best_pca

Floats = NDArray[np.float64]

PANEL = 620
"""Pixels of a panel's side."""
OVERSAMPLING = 2
DPI = 150
COLOURS = "turbo"
LARGEST_DISC = 0.012
"""Radius in diagonals: a sparse cloud is drawn with gaps."""
STEEPEST_ANGLE = 45.0
"""Degrees at the end of the scale of normal errors."""
_COVERING_NEIGHBOURS = 6
_RELIEF = 0.35
"""How much of the brightness follows the surface's direction; the rest is the colour of the error alone."""
GRID = 0.35
"""Opacity of the curves' grid."""


@dataclass(frozen=True)
class Panel:
    """One cloud of a picture.

    Attributes
    ----------
    title : str
    points, normals : (N, 3) arrays
        Normals shade the surface.
    errors : (N,) array
        What the colours show.
    """

    title: str
    points: Floats
    normals: NDArray[np.floating]
    errors: Floats


def draw_errors(path: Path, title: str, panels: Sequence[Panel], unit: str, most: float, clean: Panel) -> None:
    """Clouds side by side from one camera, their errors in colour, with a legend.

    Parameters
    ----------
    path : Path
        Of the PNG.
    title, unit : str
        Above the picture; below the colour bar.
    panels : sequence of Panel
    most : float
        Error at the end of the colour scale.
    clean : Panel
        The camera is chosen by it.
    """
    camera = view_of(clean.points, clean.normals)
    figure = Figure(figsize=(len(panels) * PANEL / DPI, (PANEL + 150) / DPI), dpi=DPI, layout="constrained")
    figure.suptitle(title, fontsize=9)
    axes = figure.subplots(1, len(panels), squeeze=False)[0]
    for axis, panel in zip(axes, panels, strict=True):
        axis.imshow(shaded(panel.points, panel.normals, error_colours(panel.errors, most), camera))
        axis.set_title(f"{panel.title}: {panel.errors.mean():.2f}", fontsize=7)
        axis.set_axis_off()
    scale = ScalarMappable(Normalize(0, most), COLOURS)
    bar = figure.colorbar(scale, ax=list(axes), orientation="horizontal", fraction=0.04, pad=0.02, extend="max")
    bar.set_label(unit, fontsize=7)
    bar.ax.tick_params(labelsize=6)
    save(figure, path)


def view_of(points: Floats, normals: NDArray[np.floating]) -> Camera:
    """Choose a camera that shows the shape of a cloud, with room around it for noise."""
    step = max(1, len(points) // 20_000)
    camera = automatic(points[::step], np.asarray(normals[::step], np.float64))
    return camera.framing(points, 1.0, 0.72)


def shaded(
    points: Floats, normals: NDArray[np.floating], colours: NDArray[np.floating], camera: Camera
) -> NDArray[np.float64]:
    """Draw a square picture of a cloud in given colours, a little darker where the surface turns away.

    Parameters
    ----------
    points, normals : (N, 3) arrays
    colours : (N, 3) array
        0 to 1.
    camera : Camera

    Returns
    -------
    (PANEL, PANEL, 3) array, 0 to 1
    """
    side = PANEL * OVERSAMPLING
    facing = camera.facing(np.asarray(normals, np.float64))
    index, _ = visible(points, facing, _radius(points), camera, side, side)
    drawn = index >= 0
    image = np.ones((side, side, 3))
    light = 1 - _RELIEF + _RELIEF * facing[:, 2:]
    image[drawn] = (colours * light)[index[drawn]]
    mean: NDArray[np.float64] = image.reshape(PANEL, OVERSAMPLING, PANEL, OVERSAMPLING, 3).mean(axis=(1, 3))
    return mean


def error_colours(errors: Floats, most: float) -> NDArray[np.float64]:
    """Colours (N, 3) of errors, the last of the scale for ``most`` and above."""
    colours: NDArray[np.float64] = colormaps[COLOURS](np.clip(errors / most, 0, 1))[:, :3]
    return colours


def _radius(points: Floats) -> Floats:
    """Discs that close the surface; single points far out stay small."""
    distance, _ = cKDTree(points).query(points, [min(_COVERING_NEIGHBOURS + 1, len(points))], workers=-1)
    typical = float(np.median(distance)) or 1.0
    largest = LARGEST_DISC * float(np.linalg.norm(np.ptp(points, axis=0)))
    radius: Floats = np.minimum(np.clip(distance[:, 0], typical, 1.5 * typical), largest)
    return radius


def draw_curves(path: Path, rows: Sequence[Row], noise: str) -> None:
    """Distance to the surface, chamfer distance and normal error over noise, means over the clouds.

    Of the rows that only estimate normals, the best at each level make one curve.
    """
    figure = Figure(figsize=(13, 4.2), dpi=DPI, layout="constrained")
    measures: list[tuple[str, Callable[[Row], float]]] = [
        ("point to surface x 1e3", lambda row: row.point_to_surface),
        ("chamfer distance x 1e5", lambda row: row.chamfer_distance),
        ("normal error, degrees", lambda row: row.normal_mean),
    ]
    chosen = [row for row in rows if row.noise == noise]
    curves = {
        method: [row for row in chosen if row.method == method]
        for method in dict.fromkeys(row.method for row in chosen if row.group != "normals")
    }
    places = dict.fromkeys((row.cloud, row.level) for row in chosen)
    best = [row for cloud, level in places if (row := best_pca(chosen, cloud, noise, level)) is not None]
    styles = {"input": ":", "peer": "--", "ours": "-", "normals": "-."}
    for axis, (label, value) in zip(figure.subplots(1, 3), measures, strict=True):
        shown = curves | ({BEST_PCA: best} if best and label.startswith("normal") else {})
        for number, (method, points) in enumerate(shown.items()):
            levels, means = _means(points, value)
            style = styles[points[0].group]
            axis.plot(levels, means, style, color=f"C{number % 10}", marker=".", linewidth=1.2, label=method)
        axis.set_xlabel(f"{noise} noise, % of the diagonal")
        axis.set_ylabel(label)
        axis.set_yscale("symlog", linthresh=1.0)
        axis.grid(alpha=GRID)
        axis.legend(fontsize=6)
    save(figure, path)


def _means(rows: Sequence[Row], value: Callable[[Row], float]) -> tuple[list[float], list[float]]:
    levels = sorted({row.level for row in rows})
    return levels, [fmean(value(row) for row in rows if row.level == level) for level in levels]


def save(figure: Any, path: Path) -> None:
    """As a PNG that is the same for the same picture."""
    FigureCanvasAgg(figure)
    figure.savefig(path, metadata={"Software": None})
