"""The worker's models: loaded on first use, on one device; what a GPU without memory does to a tile."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import Any

import torch

import pcdnf
from pcdnf.denoiser import Cloud, Denoiser, ShouldStop, TileResult
from pcdnf.errors import PcdnfError

from .settings import Settings

log = logging.getLogger(__name__)

MODELS_KEPT = 2
SMALLEST_BATCH = 8


class Models:
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
                "PCDNF_REQUIRE_GPU is set, but the worker would run on the CPU.",
                code="gpu_required",
                hint="Give the process a CUDA device and a CUDA build of torch, or unset PCDNF_REQUIRE_GPU.",
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


def denoise_tile(
    denoiser: Denoiser,
    cloud: Cloud,
    start: int,
    stop: int,
    *,
    progress: Callable[[int], None],
    should_stop: ShouldStop,
) -> TileResult:
    """Denoise a tile; a GPU out of memory is tried again with half the batch.

    Raises
    ------
    PcdnfError
        ``out_of_memory``, when the smallest batch does not fit either.
    """
    while True:
        try:
            return denoiser.denoise_tile(cloud, start, stop, progress=progress, should_stop=should_stop)
        except torch.OutOfMemoryError as error:
            if denoiser.batch <= SMALLEST_BATCH:
                raise PcdnfError(
                    f"The device ran out of memory with {denoiser.batch} neighbourhoods a batch.",
                    code="out_of_memory",
                    hint="Ask for a smaller model, or run the service on a larger device.",
                ) from error
        torch.cuda.empty_cache()
        denoiser.batch //= 2
        log.warning("device out of memory: now %d neighbourhoods a batch", denoiser.batch)
