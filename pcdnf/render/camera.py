"""The viewpoint of a picture of a point cloud."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .views import VIEWS

Floats = NDArray[np.float64]

FLAT = 0.5
"""A cloud whose height is under this part of its largest side lies on the ground: z is up."""
TALL = 1.2
"""One that is this much higher than wide stands upright: z is up. Otherwise y is, as in most meshes."""
_AZIMUTHS = np.radians(np.arange(15, 360, 30))
_ELEVATION = np.radians(24)
_SIDESTEP = np.radians(12)
_BINS = 6


@dataclass(frozen=True)
class Camera:
    """A perspective camera.

    Attributes
    ----------
    axes : (3, 3) array
        Rows: right, up, backward (towards the eye).
    target : (3,) array
        What it looks at.
    distance : float
        From the eye to the target.
    focal : float
        Focal length in picture heights.
    middle : (column, row)
        Place of the plane of view that is in the middle of the picture, in picture heights.
    """

    axes: Floats
    target: Floats
    distance: float
    focal: float = 2.4
    middle: tuple[float, float] = (0.0, 0.0)

    def project(self, points: Floats, height: int, width: int) -> tuple[Floats, Floats, Floats]:
        """Pixel columns, pixel rows and distances from the eye plane of (N, 3) points."""
        local = (points - self.target) @ self.axes.T
        depth = np.maximum(self.distance - local[:, 2], 1e-3 * self.distance)
        scale = self.focal * height / depth
        column = width / 2 - self.middle[0] * height + local[:, 0] * scale
        row = height / 2 - self.middle[1] * height - local[:, 1] * scale
        return column, row, depth

    def facing(self, normals: Floats) -> Floats:
        """(N, 3) normals in camera axes, turned towards the eye."""
        local = normals @ self.axes.T
        return np.where(local[:, 2:] < 0, -local, local)

    def framing(self, points: Floats, aspect: float, fill: float = 0.88) -> Camera:
        """Move the camera until 96 % of the points, each way, fill ``fill`` of a picture of this aspect."""
        camera = self
        for _ in range(6):
            column, row, depth = camera.project(points, 1, 1)
            (left, right), (top, bottom) = np.percentile(column, [2, 98]), np.percentile(row, [2, 98])
            per_pixel = camera.distance / camera.focal
            shift = (left + right - 1) / 2 * camera.axes[0] - (top + bottom - 1) / 2 * camera.axes[1]
            grown = max(bottom - top, (right - left) / aspect) / fill
            near = camera.distance - float(depth.min())
            camera = replace(
                camera,
                target=camera.target + shift * per_pixel,
                distance=max(camera.distance * grown, near + 0.2 * camera.distance),
            )
        return camera

    def zoomed(self, column: float, row: float, factor: float) -> Camera:
        """Magnify the picture around a place, given in picture heights from the middle."""
        return replace(self, focal=self.focal * factor, middle=(column * factor, row * factor))


def looking(direction: Floats, up: Floats, points: Floats) -> Camera:
    """Make a camera that sees the points from ``direction``, with ``up`` upright."""
    backward = direction / np.linalg.norm(direction)
    right = np.cross(up, backward)
    right /= np.linalg.norm(right)
    low, high = np.percentile(points, [1, 99], axis=0)
    axes = np.array([right, np.cross(backward, right), backward])
    return Camera(axes, (low + high) / 2, 2.6 * float(np.linalg.norm(high - low)) or 1.0)


def named(view: str, up: str, points: Floats) -> Camera:
    """One of :data:`~pcdnf.render.views.VIEWS`, with an axis of :data:`~pcdnf.render.views.UPS` upright.

    From the front, x runs right (y if x is up).
    """
    axis = "xyz".index(up[-1])
    upright = np.eye(3)[axis] * (-1 if up.startswith("-") else 1)
    right = np.eye(3)[1 if axis == 0 else 0]
    front = np.cross(right, upright)
    right_, up_, front_ = VIEWS[view]
    direction = right_ * right + up_ * upright + front_ * front
    top = -np.sign(up_) * front if right_ == front_ == 0 else upright
    return looking(direction, top, points)


def automatic(points: Floats, normals: Floats, up: str | None = None) -> Camera:
    """Choose a camera that shows the shape of a cloud.

    A scan whose sensor, at the origin, lies outside its box is seen from near the sensor; anything else
    from 24 degrees above, from the side on which most differently turned surfaces are seen. Of ``up``, one of
    :data:`~pcdnf.render.views.UPS`, nothing is guessed.
    """
    low, high = np.percentile(points, [1, 99], axis=0)
    sides, middle = high - low, (low + high) / 2
    if up is None and bool(((low > 0) | (high < 0)).any()) and np.linalg.norm(middle) < 4 * np.linalg.norm(sides):
        optical = abs(middle[2]) > 0.7 * np.linalg.norm(middle)
        upright = np.array([0.0, -1, 0]) if optical else np.array([0.0, 0, 1])
        aside = _turned(-middle, upright, _SIDESTEP) + 0.25 * np.linalg.norm(middle) * upright
        return looking(aside, upright, points)
    guessed = "z" if sides[2] < FLAT * sides.max() or sides[2] > TALL * max(sides[:2]) else "y"
    axis = "xyz".index((up or guessed)[-1])
    upright = np.eye(3)[axis] * (-1 if (up or guessed).startswith("-") else 1)
    ahead = np.eye(3)[(axis + 1) % 3] * np.cos(_ELEVATION) + upright * np.sin(_ELEVATION)
    views = [looking(_turned(ahead, upright, azimuth), upright, points) for azimuth in _AZIMUTHS]
    return max(views, key=lambda camera: _variety(camera, points, normals))


def _turned(direction: Floats, axis: Floats, angle: float) -> Floats:
    """Rodrigues' rotation about a unit axis."""
    parallel = axis * (axis @ direction)
    turned: Floats = parallel + np.cos(angle) * (direction - parallel) + np.sin(angle) * np.cross(axis, direction)
    return turned


def _variety(camera: Camera, points: Floats, normals: Floats) -> float:
    """How many differently turned surfaces the front of the cloud shows: entropy of its normals."""
    column, row, depth = camera.framing(points, 1.0).project(points, 48, 48)
    cell = np.floor(column).astype(np.int64) * 64 + np.floor(row).astype(np.int64)
    order = np.lexsort((depth, cell))
    _, first = np.unique(cell[order], return_index=True)
    facing = camera.facing(normals)[order[first]]
    counts, _ = np.histogramdd(facing[:, :2], bins=_BINS, range=[(-1, 1), (-1, 1)])
    share = counts[counts > 0] / len(first)
    return float(-(share * np.log(share)).sum() * np.sqrt(len(first)))
