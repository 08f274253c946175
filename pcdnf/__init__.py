"""PCDNF: point-cloud denoising with joint normal filtering (Liu et al., TVCG 2023).

>>> from pcdnf import Denoiser
>>> result = Denoiser.load("pcdnf-lite").denoise(points)   # points (N, 3)

Names are imported on first use, so that ``pcdnf.formats`` costs no torch. ``Denoiser`` needs the extra ``denoise``.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from ._version import __version__ as __version__

if TYPE_CHECKING:
    from .denoiser import Denoiser as Denoiser
    from .formats import PointCloud as PointCloud
    from .inference.results import DenoiseResult as DenoiseResult
    from .inference.runner import Stopped as Stopped

_HOMES = {
    "Denoiser": "denoiser",
    "DenoiseResult": "inference.results",
    "Stopped": "inference.runner",
    "PointCloud": "formats",
}
__all__ = ["DenoiseResult", "Denoiser", "PointCloud", "Stopped", "__version__"]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        try:
            return getattr(importlib.import_module(f".{_HOMES[name]}", __name__), name)
        except ModuleNotFoundError as error:
            from .errors import missing_extra

            raise missing_extra(error) from error
    raise AttributeError(f"module 'pcdnf' has no attribute {name!r}")
