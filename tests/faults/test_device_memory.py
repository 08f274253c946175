"""A device out of memory in the middle of a job, injected into a real worker."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from apart import TILE, Apart, nothing_left_over, succeeded, until
from service_process import write_sphere

from pcdnf.formats import read

INJECTION = """
import importlib.util, os, sys

class Injector:
    def find_spec(self, name, path=None, target=None):
        if name != "pcdnf.inference":
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        load = spec.loader.exec_module
        def exec_module(module):
            load(module)
            import torch
            network = module.Inference.network
            def small(self, points, *others):
                if len(points) > int(open(os.environ["DEVICE_HOLDS"]).read()):
                    raise torch.OutOfMemoryError("injected")
                return network(self, points, *others)
            module.Inference.network = small
        spec.loader.exec_module = exec_module
        return spec

sys.meta_path.insert(0, Injector())
"""


def test_device_out_of_memory(tmp_path: Path) -> None:
    path = write_sphere(tmp_path / "a.ply", 2 * TILE)
    service = Apart(tmp_path / "service", tile_points=TILE)
    service.start()
    expected = succeeded(service, service.submit(path)["id"])
    sound = dict(service.environment)
    (tmp_path / "sitecustomize.py").write_text(INJECTION)
    service.environment |= {
        "PYTHONPATH": os.pathsep.join([str(tmp_path), sound.get("PYTHONPATH", "")]),
        "DEVICE_HOLDS": str(tmp_path / "holds"),
    }
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
