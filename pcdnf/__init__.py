"""PCDNF: point-cloud denoising with joint normal filtering (Liu et al., TVCG 2023).

>>> from pcdnf import Denoiser
>>> result = Denoiser.load("pcdnf-lite").denoise(points)   # points (N, 3)

Names are imported on first use, so that ``pcdnf.formats`` costs no torch.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from .denoiser import Denoiser as Denoiser
    from .denoiser import DenoiseResult as DenoiseResult
    from .denoiser import Stopped as Stopped
    from .formats import PointCloud as PointCloud

_HOMES = {
    "Denoiser": "denoiser",
    "DenoiseResult": "denoiser",
    "Stopped": "denoiser",
    "PointCloud": "formats",
}
__all__ = ["DenoiseResult", "Denoiser", "PointCloud", "Stopped", "__version__"]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(importlib.import_module(f".{_HOMES[name]}", __name__), name)
    raise AttributeError(f"module 'pcdnf' has no attribute {name!r}")
