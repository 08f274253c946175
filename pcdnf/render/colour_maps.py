"""Values of points as colours that colour-blind readers can tell apart, and their legend."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pictures
from PIL import ImageDraw, ImageFont

from ..errors import PcdnfError
from ..formats import PointCloud
from ..metrics import SURFACE_UNIT, point_errors
from .camera import Floats
from .splats import Image

SHARE = 99.0
"""Per cent of the values below the top of a scale; a few outliers should not darken the rest."""
_NICE = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
_STEPS = 4
# viridis (matplotlib, CC0): even steps of lightness, the same order for every kind of colour blindness
_COLOURS = np.array([
    [0.267, 0.005, 0.329], [0.282, 0.095, 0.417], [0.279, 0.175, 0.483], [0.259, 0.252, 0.525], [0.230, 0.322, 0.546],
    [0.199, 0.388, 0.555], [0.173, 0.449, 0.558], [0.149, 0.508, 0.557], [0.128, 0.567, 0.551], [0.121, 0.626, 0.533],
    [0.158, 0.684, 0.502], [0.246, 0.739, 0.452], [0.369, 0.789, 0.383], [0.516, 0.831, 0.294], [0.678, 0.864, 0.190],
    [0.846, 0.887, 0.100], [0.993, 0.906, 0.144],
])  # fmt: skip


@dataclass(frozen=True)
class ColourScale:
    """The values that the colours stand for: 0 to ``top``, in the unit of the file.

    Attributes
    ----------
    top : float
        A round number.
    exceeded : bool
        Whether there are larger values, drawn in the last colour.
    """

    top: float
    exceeded: bool

    @classmethod
    def of(cls, *values: Floats) -> ColourScale:
        """Make one scale for several arrays (N,)."""
        every = np.concatenate(values)
        most = float(np.percentile(every, SHARE))
        top = _rounded_up(most) if most > 0 else _rounded_up(float(every.max())) if every.max() > 0 else 1.0
        return cls(top, bool(every.max() > top))

    @property
    def ticks(self) -> list[tuple[float, str]]:
        """Values and their labels."""
        values = [self.top * step / _STEPS for step in range(_STEPS + 1)]
        labels = [f"{value:.3g}" for value in values]
        return list(zip(values, [*labels[:-1], labels[-1] + ("+" if self.exceeded else "")], strict=True))

    def colours(self, values: Floats) -> Image:
        """Linear light (N, 3) of values (N,)."""
        share = np.clip(values / self.top, 0, 1) * (len(_COLOURS) - 1)
        places = np.arange(len(_COLOURS))
        encoded = np.stack([np.interp(share, places, _COLOURS[:, axis]) for axis in range(3)], axis=1)
        return np.asarray(encoded**2.2, np.float32)


def displacement(before: PointCloud, after: PointCloud) -> Floats:
    """How far each point moved (N,), in the unit of the file.

    Raises
    ------
    PcdnfError
        ``different_clouds`` where the clouds do not have the same number of points.
    """
    if len(before) != len(after):
        raise PcdnfError(
            f"The clouds have {len(before):,} and {len(after):,} points, so their points cannot be matched.",
            code="different_clouds",
            hint="Name the clean cloud with --clean to see the error, or omit the map with --map none.",
        )
    moved: Floats = np.linalg.norm(after.points.astype(np.float64) - before.points.astype(np.float64), axis=1)
    return moved


def error(cloud: PointCloud, clean: PointCloud) -> Floats:
    """Distance of each point to the clean surface (N,), in the unit of the file; see ``pcdnf.metrics``."""
    diagonal = float(np.linalg.norm(np.ptp(clean.points.astype(np.float64), axis=0)))
    errors = point_errors(cloud.points, None, clean.points, clean.normals)
    return np.asarray(errors.surface * SURFACE_UNIT * diagonal, np.float64)


def described(values: Floats) -> str:
    """Describe values by mean, 95th percentile and maximum, for a caption."""
    return f"mean {values.mean():.3g}, 95 % below {np.percentile(values, 95):.3g}, maximum {values.max():.3g}"


def draw_legend(
    panel: Pictures.Image, scale: ColourScale, unit: str, margin: int, colour: tuple[int, int, int]
) -> tuple[int, int, int, int]:
    """Draw a horizontal bar with numbers at the foot of a panel; return the box of the bar."""
    width, height = panel.size
    size = max(min(width, height) * 0.028, 10)
    font = ImageFont.load_default(size)
    thick = max(int(size * 0.7), 4)
    left, right = int(width * 0.5 - width * 0.32), int(width * 0.5 + width * 0.32)
    top = height - margin - int(size * 3.0)
    ramp = scale.colours(np.linspace(0, scale.top, right - left)) ** (1 / 2.2)
    strip: NDArray[np.uint8] = np.broadcast_to((ramp * 255 + 0.5).astype(np.uint8), (thick, right - left, 3))
    panel.paste(Pictures.fromarray(np.ascontiguousarray(strip)), (left, top))
    pen = ImageDraw.Draw(panel)
    for value, label in scale.ticks:
        column = left + (right - left) * value / scale.top
        pen.line([column, top + thick, column, top + thick + size * 0.3], fill=colour, width=max(1, int(size / 14)))
        pen.text((column, top + thick + size * 0.4), label, fill=colour, font=font, anchor="ma")
    pen.text(((left + right) / 2, top + thick + size * 1.65), unit, fill=colour, font=font, anchor="ma")
    return left, top, right, top + thick


def _rounded_up(value: float) -> float:
    """Return the next round number."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(nice for nice in _NICE if nice * power >= value * (1 - 1e-9)) * power)
