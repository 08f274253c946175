"""A device out of memory in the middle of a job, injected into a real worker."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from pcdnf.formats import read
from tests.support.apart import TILE, Apart, nothing_left_over, succeeded, until
from tests.support.injection import inject
from tests.support.service_process import write_sphere


def holds_few(inference: ModuleType) -> None:
    """The device holds as many patches as a file says."""
    import os
    from pathlib import Path

    import torch

    network = inference.Inference.network

    def small(self: Any, points: torch.Tensor, normals: torch.Tensor) -> Any:
        if len(points) > int(Path(os.environ["DEVICE_HOLDS"]).read_text()):
            raise torch.OutOfMemoryError("injected")
        return network(self, points, normals)

    inference.Inference.network = small


def test_device_out_of_memory(tmp_path: Path) -> None:
    path = write_sphere(tmp_path / "a.ply", 2 * TILE)
    service = Apart(tmp_path / "service", tile_points=TILE)
    service.start()
    expected = succeeded(service, service.submit(path)["id"])
    inject(service, tmp_path, "pcdnf.inference.runner", holds_few, DEVICE_HOLDS=tmp_path / "holds")
    for holds in (100, 1):
        (tmp_path / "holds").write_text("1000000")  # the model is warmed first
        service.kill_worker()
        starts = service.output().count("worker worker-0 ready")
        service.start_worker()
        until(lambda starts=starts: service.output().count("worker worker-0 ready") > starts)
        (tmp_path / "holds").write_text(str(holds))
        job = service.submit(path)["id"]
        if holds == 100:
            (tmp_path / "result.ply").write_bytes(succeeded(service, job))
            (tmp_path / "expected.ply").write_bytes(expected)
            found, wanted = read(tmp_path / "result.ply"), read(tmp_path / "expected.ply")
            assert np.abs(found.points - wanted.points).max() < 1e-5
            assert "device out of memory: now 64 neighbourhoods a batch" in service.output()
        else:
            failed = service.wait_status(job, "failed", "succeeded")
            assert (failed["status"], failed["problem"]["code"]) == ("failed", "out_of_memory")
            assert failed["problem"]["hint"]
    (tmp_path / "holds").write_text("1000000")  # what the other program held is free again
    succeeded(service, service.submit(path)["id"])
    nothing_left_over(service)
    assert service.stop() == 0, service.output()
