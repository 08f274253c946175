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

from pcdnf.errors import PcdnfError
from pcdnf.models.catalog import WEIGHTS
from service.settings import Settings
from service.supervision import EX_CONFIG
from service.worker.main import limit_threads
from service.worker.model_cache import MODELS_KEPT, ModelCache
from service.worker.slot import SlotTakenError, take_slot


def _worker(tmp_path: Path, **settings: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PCDNF_DATA_DIR": str(tmp_path)}
    environment |= {f"PCDNF_{name.upper()}": value for name, value in settings.items()}
    return subprocess.run(
        [sys.executable, "-m", "service.worker"], env=environment, capture_output=True, text=True, timeout=60
    )


def test_one_process_a_slot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.worker.slot.LOCK_WAIT_SECONDS", 0.3)
    settings = Settings(data_dir=tmp_path)
    held = take_slot(settings)
    with pytest.raises(SlotTakenError):
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
    models = ModelCache(Settings(device="cpu"))
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
    models = ModelCache(Settings(device="cpu"))
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
