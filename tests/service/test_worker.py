from __future__ import annotations

import inspect
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from dbos import DBOS
from service_process import sphere

from pcdnf.checkpoint import WEIGHTS
from pcdnf.denoiser import Denoiser, TileResult
from pcdnf.errors import PcdnfError
from service.models import MODELS_KEPT, SMALLEST_BATCH, Models, denoise_tile
from service.process import EX_CONFIG
from service.settings import Settings
from service.worker import SlotTaken, limit_threads, take_slot


def _worker(tmp_path: Path, **settings: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PCDNF_DATA_DIR": str(tmp_path)}
    environment |= {f"PCDNF_{name.upper()}": value for name, value in settings.items()}
    return subprocess.run(
        [sys.executable, "-m", "service.worker"], env=environment, capture_output=True, text=True, timeout=60
    )


def test_one_process_a_slot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.worker.LOCK_WAIT_SECONDS", 0.3)
    settings = Settings(data_dir=tmp_path)
    held = take_slot(settings)
    with pytest.raises(SlotTaken):
        take_slot(settings)
    take_slot(Settings(data_dir=tmp_path, worker_id="worker-1")).close()
    held.close()
    take_slot(settings).close()


@pytest.mark.skipif(torch.cuda.is_available(), reason="needs a machine without a GPU")
def test_require_gpu_refuses(tmp_path: Path) -> None:
    ended = _worker(tmp_path, require_gpu="true")
    assert ended.returncode == EX_CONFIG
    assert "PCDNF_REQUIRE_GPU" in ended.stderr
    assert "Traceback" not in ended.stderr


def test_a_device_that_is_not_there(tmp_path: Path) -> None:
    ended = _worker(tmp_path, device="cuda:99")
    assert ended.returncode == EX_CONFIG
    assert "cuda:99" in ended.stderr
    assert "Traceback" not in ended.stderr


def test_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    for variable in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
        monkeypatch.setenv(variable, "")
    assert limit_threads(Settings(threads=3)) == 3
    assert os.environ["NUMBA_NUM_THREADS"] == "3"
    assert limit_threads(Settings()) >= 1


def test_the_private_call_of_the_engine_that_takes_work_over() -> None:
    parameters = inspect.signature(DBOS._recover_pending_workflows).parameters
    assert list(parameters) == ["executor_ids"]


def test_models_are_kept_and_said_where_they_run() -> None:
    models = Models(Settings(device="cpu"))
    assert models.get("pcdnf-lite") is models.get("pcdnf-lite")
    execution = models.execution("pcdnf-lite")
    assert execution["device"] == execution["device_requested"] == "cpu"
    assert execution["cpu_fallback"] is False
    with pytest.raises(PcdnfError, match="no model"):
        models.get("nothing")


def test_the_model_not_used_for_longest_leaves(tmp_path: Path) -> None:
    copies = [tmp_path / f"{number}.safetensors" for number in range(MODELS_KEPT)]
    for copy in copies:
        shutil.copy(WEIGHTS / "pcdnf-lite.safetensors", copy)
    models = Models(Settings(device="cpu"))
    names = ["pcdnf-lite", *map(str, copies)]
    first, second, *_ = [models.get(name) for name in names[:-1]]
    assert models.get(names[0]) is first  # so the second is the one not used for longest
    models.get(names[-1])
    assert models.get(names[0]) is first
    assert models.get(names[1]) is not second


def test_a_worker_listens_nowhere_and_needs_no_key(tmp_path: Path) -> None:
    ended = _worker(tmp_path, host="0.0.0.0", default_model="nothing")  # it gets as far as its model
    assert ended.returncode == EX_CONFIG
    assert "no model" in ended.stderr
    assert "PCDNF_API_KEY" not in ended.stderr


class _Small:
    """A device that holds batches of 16 at most."""

    def __init__(self, holds: int) -> None:
        self.batch, self.holds, self.tried = 64, holds, list[int]()

    def denoise_tile(self, *_: object, **__: object) -> str:
        self.tried.append(self.batch)
        if self.batch > self.holds:
            raise torch.OutOfMemoryError
        return "tile"


def _denoise(device: _Small) -> TileResult:
    return denoise_tile(device, None, 0, 1, progress=lambda _: None, should_stop=lambda: False)  # type: ignore[arg-type]


def test_out_of_device_memory_halves_the_batch() -> None:
    device = _Small(holds=16)
    assert _denoise(device) == "tile"  # type: ignore[comparison-overlap]
    assert device.tried == [64, 32, 16]
    device = _Small(holds=0)
    with pytest.raises(PcdnfError) as caught:
        _denoise(device)
    assert caught.value.code == "out_of_memory"
    assert device.tried[-1] == SMALLEST_BATCH


def test_the_batch_does_not_change_the_result() -> None:
    denoiser = Denoiser.load("pcdnf-lite", device="cpu")
    points = sphere(600)
    first = denoiser.denoise(points)
    denoiser.batch //= 8
    second = denoiser.denoise(points)
    assert abs(first.points - second.points).max() < 1e-6
