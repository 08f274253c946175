"""Compile every kernel that denoising needs into ``NUMBA_CACHE_DIR``: one small cloud through each model."""

from __future__ import annotations

from pcdnf.checkpoint import available_models
from pcdnf.denoiser import Denoiser

for model in available_models():
    Denoiser.load(model.name, device="cpu").warm_up()
