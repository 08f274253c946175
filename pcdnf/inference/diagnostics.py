"""What was done to each point, and how far that can be relied upon."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FARTHEST = 4.5
"""Longest way from where a point came, in noises around it."""
USUAL_MOVE = 2.0
"""Moves up to this many noises are what noise makes usual."""
DOUBTFUL = 0.6
"""Confidence of a moved point below which the move is doubtful: 3 noises and more."""


@dataclass(frozen=True)
class Diagnostics:
    """Of N points, in the cloud's unit.

    Attributes
    ----------
    displacement : ndarray, (N,) float32
        How far each point was moved.
    noise : ndarray, (N,) float32
        Standard deviation that was estimated around it; 0 for a row without a measurement.
    confidence : ndarray, (N,) float32
        1 for a move that the noise makes usual, falling to 0 for the longest that is allowed; 0 for a point that was
        left where it came, unless there was no noise to remove.
    """

    displacement: NDArray[np.float32]
    noise: NDArray[np.float32]
    confidence: NDArray[np.float32]

    def columns(self) -> dict[str, NDArray[np.float32]]:
        """Columns of a file, by name."""
        return {
            "displacement": self.displacement,
            "estimated_noise": self.noise,
            "confidence": self.confidence,
        }

    def shares(self) -> dict[str, float]:
        """Return the shares of points, 0 to 1: ``moved``, ``left`` where they came, and moved ``doubtful`` far."""
        moved = self.displacement > 0
        doubtful = moved & (self.confidence < DOUBTFUL)
        return {name: float(each.mean()) for name, each in (("moved", moved), ("left", ~moved), ("doubtful", doubtful))}

    def metadata(self) -> dict[str, str]:
        """Return the shares as a result records them."""
        return {name: f"{share:.2%}" for name, share in self.shares().items()}


def diagnose(came: NDArray[np.floating], moved: NDArray[np.floating], noise: NDArray[np.floating]) -> Diagnostics:
    """Compare a cloud before and after.

    Parameters
    ----------
    came, moved : ndarray, (N, 3) float
    noise : ndarray, (N,) float
        See :meth:`pcdnf.inference.survey.Survey.noise`.
    """
    displacement = np.linalg.norm(np.asarray(moved, np.float64) - np.asarray(came, np.float64), axis=1)
    share = displacement / np.maximum(noise, 1e-300)
    confidence = np.clip((FARTHEST - share) / (FARTHEST - USUAL_MOVE), 0, 1)
    confidence[(displacement == 0) & (noise > 0)] = 0
    return Diagnostics(displacement.astype(np.float32), np.asarray(noise, np.float32), confidence.astype(np.float32))
