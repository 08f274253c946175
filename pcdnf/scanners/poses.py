"""Rotations, and the small errors of registration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from scipy.spatial.transform import Rotation

from .scene import Floats


@dataclass(frozen=True)
class RegistrationError:
    """A small rigid motion of one station's or view's points.

    Attributes
    ----------
    turn : ndarray, (3, 3)
    shift : ndarray, (3,)
    about : ndarray, (3,)
        Centre of the rotation.
    """

    turn: Floats
    shift: Floats
    about: Floats

    def __call__(self, points: Floats) -> Floats:
        """Points (N, 3) as registered."""
        return np.asarray((points - self.about) @ self.turn.T + self.about + self.shift)


def registration_error(rng: Generator, about: Floats, shift: float, turn: float) -> RegistrationError:
    """Return a random one; ``shift`` and ``turn`` (radians) are standard deviations along and about each axis."""
    vector = rng.normal(0, turn, 3)
    return RegistrationError(
        np.asarray(Rotation.from_rotvec(vector).as_matrix()), rng.normal(0, shift, 3), np.asarray(about, float)
    )


def looking(at: Floats, origin: Floats, roll: float = 0.0) -> Floats:
    """Axes of a camera at ``origin`` as rows (3, 3): right, down, towards ``at``."""
    ahead = np.asarray(at, float) - np.asarray(origin, float)
    ahead /= np.linalg.norm(ahead)
    helper = np.array([0.0, 0.0, 1.0]) if abs(ahead[2]) < 0.98 else np.array([0.0, 1.0, 0.0])
    right = np.cross(ahead, helper)
    right /= np.linalg.norm(right)
    down = np.cross(ahead, right)
    cosine, sine = np.cos(roll), np.sin(roll)
    return np.stack([cosine * right + sine * down, cosine * down - sine * right, ahead])
