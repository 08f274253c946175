"""Depth cameras that triangulate: noise and steps that grow with the square of the depth, in windows of pixels.

Structured light (Kinect): a standard deviation of 1.43e-3 z^2 and steps of 2.85e-3 z^2 metres (Khoshelham and Oude
Elberink 2012, "Accuracy and resolution of Kinect depth data for indoor mapping applications"). 0.0012 + 0.0019 (z -
0.4)^2, and 0.8 pixels sideways (Nguyen, Izadi and Lovell 2012, "Modeling Kinect sensor noise for improved 3D
reconstruction and tracking"). Active stereo: z^2 / (f b) times some 0.08 pixels of disparity, and a window that
correlates neighbours (Keselman et al. 2017, "Intel RealSense stereoscopic depth cameras").
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from scipy.ndimage import gaussian_filter, maximum_filter, minimum_filter

from .poses import looking, registration_error
from .scan import Returns, Scan
from .scene import Bools, Floats
from .surface import Surface


@dataclass(frozen=True)
class DepthCamera:
    """A camera.

    Attributes
    ----------
    width, height : int
        Pixels.
    focal : float
        Pixels.
    noise, step, floor : float
        Standard deviation and quantisation step of the depth, over its square (1 / m); noise at no distance (m).
    window : float
        Standard deviation of the correlation window, pixels.
    jitter : float
        Standard deviation of a pixel's direction, pixels.
    flying : float
        Share of the pixels at depth edges that lie between the two depths.
    nearest, farthest : float
        Range, metres.
    """

    width: int
    height: int
    focal: float
    noise: float
    step: float
    floor: float
    window: float
    jitter: float
    flying: float
    nearest: float = 0.4
    farthest: float = 5.0

    def resized(self, width: int) -> DepthCamera:
        """Return the same camera with other pixels."""
        scale = width / self.width
        return DepthCamera(
            width,
            round(self.height * scale),
            self.focal * scale,
            self.noise,
            self.step,
            self.floor,
            self.window * scale,
            self.jitter * scale,
            self.flying,
            self.nearest,
            self.farthest,
        )


def random_camera(rng: Generator) -> DepthCamera:
    """Structured light or active stereo, of 640 by 480 pixels."""
    flying = rng.uniform(0.3, 0.8)
    if rng.random() < 0.5:
        noise = rng.uniform(1.2e-3, 1.9e-3)
        return DepthCamera(640, 480, 580.0, noise, 2.85e-3, 0.0010, rng.uniform(1.0, 2.5), 0.5, flying)
    pixel = 1 / (385.0 * 0.050)  # RealSense D435: 50 mm between the cameras, 385 pixels of focal length at 640
    noise = rng.uniform(0.06, 0.12) * pixel
    return DepthCamera(640, 480, 385.0, noise, pixel / 32, 0.0004, rng.uniform(2.0, 4.0), 0.5, flying)


def scan(
    rng: Generator,
    name: str,
    surface: Surface,
    camera: DepthCamera,
    origins: Floats,
    targets: Floats,
    *,
    shift: float,
    turn: float,
) -> Scan:
    """Frames from ``origins`` towards ``targets``, (S, 3) each, merged by poses with errors; one frame has none.

    ``shift`` (metres) and ``turn`` (radians) are the standard deviations of a pose along and about each axis.
    """
    returns = Returns()
    for number, (at, target) in enumerate(zip(origins, targets, strict=True)):
        true, noisy, deviation = _frame(rng, surface, camera, at, looking(target, at))
        registered = noisy if number == 0 else registration_error(rng, at, shift, turn)(noisy)
        returns.add(registered, true, deviation, registered - noisy, number)
    return returns.scan(name, surface, origins)


def _frame(
    rng: Generator, surface: Surface, camera: DepthCamera, at: Floats, axes: Floats
) -> tuple[Floats, Floats, Floats]:
    """One frame: noise-free points, measured points (N, 3), standard deviations along the ray (N,)."""
    shape = (camera.height, camera.width)
    row, column = np.meshgrid(np.arange(shape[0], dtype=float), np.arange(shape[1], dtype=float), indexing="ij")
    nominal = _rays(camera, column, row)
    jitter = [camera.jitter * _windowed(rng.normal(size=shape), 1.0) for _ in range(2)]
    seen = _rays(camera, column + jitter[0], row + jitter[1])
    directions = seen.reshape(-1, 3) @ axes
    depth = surface.cast(np.broadcast_to(at, directions.shape), directions).distance.reshape(shape)
    valid = (depth > camera.nearest) & (depth < camera.farthest)
    depth = np.where(valid, depth, 0.0)
    depth = _with_flying_pixels(rng, camera, depth, valid)
    square = np.maximum(depth, camera.nearest) ** 2
    deviation = np.hypot(camera.noise * square, camera.floor)
    noise = _windowed(rng.normal(size=shape), camera.window)
    noise = 0.9 * noise + np.sqrt(1 - 0.9**2) * rng.normal(size=shape)
    inverse = 1 / np.maximum(depth + deviation * noise, 0.1)
    # steps of disparity are even steps of the inverse depth
    stepped = 1 / (np.maximum(np.round(inverse / camera.step), 1) * camera.step)
    sigma = np.hypot(deviation, camera.step * square / np.sqrt(12))
    length = np.linalg.norm(nominal, axis=-1)
    flat = valid.ravel()
    ray = (nominal.reshape(-1, 3) @ axes)[flat]
    return (
        at + depth.ravel()[flat, None] * ray,
        at + stepped.ravel()[flat, None] * ray,
        (sigma * length).ravel()[flat],
    )


def _rays(camera: DepthCamera, column: Floats, row: Floats) -> Floats:
    """Rays of depth 1 in the camera's axes, (..., 3)."""
    x = (column - 0.5 * (camera.width - 1)) / camera.focal
    y = (row - 0.5 * (camera.height - 1)) / camera.focal
    return np.stack([x, y, np.ones_like(x)], -1)


def _windowed(noise: Floats, window: float) -> Floats:
    """White noise (H, W) as a correlation window leaves it, of variance 1."""
    smooth = gaussian_filter(noise, window, mode="wrap")
    return np.asarray(smooth / max(float(smooth.std()), 1e-12))


def _with_flying_pixels(rng: Generator, camera: DepthCamera, depth: Floats, valid: Bools) -> Floats:
    """Return the depth (H, W) with a share of the pixels at its edges between the depths on both sides."""
    near = minimum_filter(np.where(valid, depth, np.inf), 3)
    far = maximum_filter(depth, 3)
    edge = valid & np.isfinite(near) & (far - near > 0.03 + 4 * camera.noise * depth**2)
    chosen = edge & (rng.random(depth.shape) < camera.flying)
    share = rng.beta(0.6, 0.6, depth.shape)
    between = np.where(np.isfinite(near), near, 0) + share * (far - np.where(np.isfinite(near), near, 0))
    return np.asarray(np.where(chosen, between, depth))
