"""One pass over a cloud made by code, in a process of its own: seconds of each stage, speed and peak memory, as JSON.

    python benchmarks/cloud_run.py --points 100000 [--threads 2] [--model pcdnf-lite] [--precision auto] [--tiles 3]

From a binary PLY to a binary PLY. Seconds are of the wall and, behind them, of the processor (all threads), which a
shared machine disturbs less. With ``--tiles`` that many tiles are denoised, evenly spread, and nothing is written.
``benchmarks/throughput.py`` runs this for several sizes and numbers of threads.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stages import Stages, now

NOISE = 0.005
"""Of the cloud's diagonal."""


def noisy_surface(count: int) -> NDArray[np.float64]:
    """A lumpy closed surface of diagonal 1, about evenly sampled, with noise: points (count, 3)."""
    rng = np.random.default_rng(0)
    points = rng.normal(size=(count, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    points *= 1 + 0.1 * np.sin(7 * points[:, :1]) * np.sin(5 * points[:, 1:2]) + 0.05 * np.sin(11 * points[:, 2:])
    points /= np.linalg.norm(np.ptp(points, axis=0))
    return points + rng.normal(size=points.shape) * NOISE


def _peak_bytes() -> int:
    """Most memory of this program; getrusage would count the one that started it."""
    found = re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text())
    assert found is not None
    return 1024 * int(found[1])


def measured(points: int, *, model: str, precision: str, tiles: int) -> dict[str, Any]:
    """Run one pass and report on it."""
    began = now()
    from pcdnf import Denoiser
    from pcdnf.formats import PointCloud, read, write
    from pcdnf.geometry import patches
    from pcdnf.inference import plan
    from pcdnf.inference import prepare as preparation
    from pcdnf.inference import runner as inference

    imported = now() - began
    stages = Stages()
    stages.watch(plan, "estimate_noise", "noise and spacing")
    stages.watch(plan, "cKDTree", "tree")
    stages.watch(preparation, "cKDTree", "tree")
    stages.watch(preparation, "raw_normals", "normals")
    stages.watch(preparation, "spatial_order", "order along a curve")
    stages.watch(preparation, "PatchSource", "grid")
    stages.watch(patches.PatchSource, "neighbours", "neighbours")
    stages.watch(patches, "local_patches", "gather and frames")
    stages.watch(inference.Inference, "network", "network")
    with tempfile.TemporaryDirectory() as folder:
        given, made = Path(folder, "noisy.ply"), Path(folder, "made.ply")
        write(given, PointCloud(points=noisy_surface(points)))
        network = Denoiser.load(model, device="cpu", precision=precision)
        network.warm_up()
        stages.seconds.clear()
        began = now()
        cloud = stages.timed(read, "reading")(given)
        if tiles:
            chosen = network.plan(cloud.points, iterations=1)
            ready = network.prepare(cloud.points, plan=chosen)
            setup = now() - began
            every = ready.tiles()
            some = [every[i] for i in np.linspace(0, len(every) - 1, tiles).astype(int)]
            for start, stop in some:
                network.denoise_tile(ready, start, stop)
            done = sum(stop - start for start, stop in some)
        else:
            result = network.denoise(cloud.points, iterations=1)
            stages.timed(write, "writing")(made, cloud.replaced(result.points, result.normals))
            setup, done = np.zeros(2), points
        spent = now() - began
    stages.seconds["rest"] = spent - sum(stages.seconds.values())
    return {
        "points": points,
        "precision": network.precision,
        "import": _rounded(imported),
        "setup": _rounded(setup),
        "seconds": _rounded(spent),
        "points_per_second": round(done / (spent - setup)[0], 1),
        "points_per_processor_second": round(done / (spent - setup)[1], 1),
        "peak_gib": round(_peak_bytes() / 2**30, 2),
        "stages": {name: _rounded(seconds) for name, seconds in sorted(stages.seconds.items(), key=_most)},
    }


def _most(item: tuple[str, NDArray[np.float64]]) -> float:
    return -float(item[1][1])


def _rounded(seconds: NDArray[np.float64]) -> list[float]:
    return [round(float(value), 2) for value in seconds]


def main() -> None:
    """Print the report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=100_000)
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    parser.add_argument("--model", default="pcdnf-lite")
    parser.add_argument("--precision", default="auto")
    parser.add_argument("--tiles", type=int, default=0, help="so many tiles alone; 0 for all of the cloud")
    arguments = parser.parse_args()
    for variable in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS"):  # before torch and Numba are imported
        os.environ[variable] = str(arguments.threads)
    report = measured(arguments.points, model=arguments.model, precision=arguments.precision, tiles=arguments.tiles)
    print(json.dumps({"threads": arguments.threads} | report))


if __name__ == "__main__":
    main()
