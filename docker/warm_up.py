"""Compile every kernel that denoising needs into ``NUMBA_CACHE_DIR``: one small cloud through each model.

In both precisions, because the machine that builds the image and the one that runs it may differ in which they take.
"""

from __future__ import annotations

from pcdnf.denoiser import Denoiser
from pcdnf.models.catalog import available_models

for model in available_models():
    for precision in ("float32", "bfloat16"):
        Denoiser.load(model.name, device="cpu", precision=precision).warm_up()
