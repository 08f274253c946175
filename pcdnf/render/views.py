"""Names of the views and of the upright axes of a picture; they need no numpy, so the command line can list them."""

from __future__ import annotations

VIEWS = {
    "front": (0, 0, 1), "back": (0, 0, -1), "right": (1, 0, 0), "left": (-1, 0, 0), "top": (0, 1, 0),
    "bottom": (0, -1, 0), "corner": (0.8, 0.7, 1),
}  # fmt: skip
"""Direction from the cloud to the eye, as parts of right, up and front."""
UPS = ("x", "y", "z", "-x", "-y", "-z")
"""Axes of the cloud that may point up in the picture."""
