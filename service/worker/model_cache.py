"""The worker's models: loaded on first use, on one device."""

from __future__ import annotations

import logging
import threading
from typing import Any

import torch

import pcdnf
from pcdnf.denoiser import Denoiser
from pcdnf.errors import PcdnfError

from ..settings import Settings

log = logging.getLogger(__name__)

MODELS_KEPT = 2


class ModelCache:
    """Denoisers by name, the least recently used leaving first.

    Parameters
    ----------
    settings : Settings

    Raises
    ------
    PcdnfError
        If the device is not there, or only a CPU is and ``require_gpu`` is set.
    """

    def __init__(self, settings: Settings) -> None:
        self._requested = settings.device
        self._precision = settings.precision
        self._loaded: dict[str, Denoiser] = {}
        self._lock = threading.Lock()
        self.device = self._requested
        if self._requested == "auto":
            self.device = "cuda:0" if torch.cuda.is_available() else "cpu"
        if settings.require_gpu and self.device == "cpu":
            raise PcdnfError(
                "PCDNF_REQUIRE_GPU is set, but the worker found no GPU.",
                code="gpu_required",
                hint="Give the process a CUDA device and install a CUDA build of torch, or unset PCDNF_REQUIRE_GPU.",
            )

    def get(self, name: str) -> Denoiser:
        """Return the denoiser of a shipped model, loaded and warmed by one real small cloud.

        Raises
        ------
        PcdnfError
            If it cannot be loaded on the device.
        """
        with self._lock:
            denoiser = self._loaded.pop(name, None)
            if denoiser is None:
                if len(self._loaded) >= MODELS_KEPT:
                    del self._loaded[next(iter(self._loaded))]
                denoiser = Denoiser.load(name, device=self.device, precision=self._precision)
                denoiser.warm_up()
                log.info("model %s loaded on %s in %s", name, denoiser.device, denoiser.precision)
            self._loaded[name] = denoiser
            return denoiser

    def execution(self, name: str) -> dict[str, Any]:
        """Return on what a job of this model runs, as it is shown to callers."""
        denoiser = self.get(name)
        assert denoiser.info is not None
        fallback = self._requested == "auto" and self.device == "cpu"
        return {
            "model": name,
            "weights_sha256": denoiser.info.sha256,
            "device": denoiser.device,
            "device_requested": self._requested,
            "cpu_fallback": fallback,
            "precision": denoiser.precision,
            "version": pcdnf.__version__,
        }
